// The ends of carry chains, for Yosys's `techmap` once all is mapped: see `boards/ecp5_carries.v`.
//
// A pin that is connected to x is one that nextpnr knows and connects to nothing.

// Begins a chain. One whose carry is not its own, for what stood before it turned out to be constant, keeps that.
module CCU2C_FIRST (CIN, A0, B0, C0, D0, A1, B1, C1, D1, S0, S1, COUT);
	parameter [15:0] INIT0 = 0;
	parameter [15:0] INIT1 = 0;
	parameter INJECT1_0 = "YES";
	parameter INJECT1_1 = "YES";
	input CIN, A0, B0, C0, D0, A1, B1, C1, D1;
	output S0, S1, COUT;
	generate
		if (INIT0[15:4] == 0)
			CCU2C #(.INIT0(INIT0), .INIT1(INIT1), .INJECT1_0(INJECT1_0), .INJECT1_1(INJECT1_1)) _TECHMAP_REPLACE_ (
				.CIN(1'bx), .A0(A0), .B0(B0), .C0(C0), .D0(D0), .A1(A1), .B1(B1), .C1(C1), .D1(D1),
				.S0(S0), .S1(S1), .COUT(COUT)
			);
		else
			CCU2C #(.INIT0(INIT0), .INIT1(INIT1), .INJECT1_0(INJECT1_0), .INJECT1_1(INJECT1_1)) _TECHMAP_REPLACE_ (
				.CIN(CIN), .A0(A0), .B0(B0), .C0(C0), .D0(D0), .A1(A1), .B1(B1), .C1(C1), .D1(D1),
				.S0(S0), .S1(S1), .COUT(COUT)
			);
	endgenerate
endmodule

// Ends one.
module CCU2C_LAST (CIN, A0, B0, C0, D0, A1, B1, C1, D1, S0, S1, COUT);
	parameter [15:0] INIT0 = 0;
	parameter [15:0] INIT1 = 0;
	parameter INJECT1_0 = "YES";
	parameter INJECT1_1 = "YES";
	input CIN, A0, B0, C0, D0, A1, B1, C1, D1;
	output S0, S1, COUT;
	CCU2C #(.INIT0(INIT0), .INIT1(INIT1), .INJECT1_0(INJECT1_0), .INJECT1_1(INJECT1_1)) _TECHMAP_REPLACE_ (
		.CIN(CIN), .A0(A0), .B0(B0), .C0(C0), .D0(D0), .A1(A1), .B1(B1), .C1(C1), .D1(D1),
		.S0(S0), .S1(S1), .COUT(1'bx)
	);
endmodule
