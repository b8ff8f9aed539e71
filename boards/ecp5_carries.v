// Sums and comparisons on the carries of an ECP5, for Yosys's `techmap`, in as few cells as nextpnr lets them take.
//
// A chain as Yosys makes it costs four cells beside its bits: nextpnr puts two before it, to bring in a carry that is
// not another's, be it constant, and two behind it, to bring out one that nobody looks at. Here the first slot of a
// chain makes its carry without looking at the one that comes: its LUT4 is 0, and so the LUT2 of A and B is the carry.
//
// - Where what comes in is constant, the first slot is bit 0, whose sum takes a LUT beside it; but a sum of an odd
//   number of bits has a slot to spare, which does it as follows.
// - Where it is not, the first slot brings it in, and bit 0 is in the second.
// - The slot above the highest bit brings out the carry, if it is used.
//
// `boards/ecp5_ends.v` does the rest once it is known what is used.

(* techmap_celltype = "$alu" *)
module carries (A, B, CI, BI, X, Y, CO);
	parameter A_SIGNED = 0;
	parameter B_SIGNED = 0;
	parameter A_WIDTH = 1;
	parameter B_WIDTH = 1;
	parameter Y_WIDTH = 1;
	parameter _TECHMAP_CONSTMSK_CI_ = 0;
	parameter _TECHMAP_CONSTVAL_CI_ = 0;
	parameter _TECHMAP_CONSTMSK_BI_ = 0;
	parameter _TECHMAP_CONSTVAL_BI_ = 0;

	(* force_downto *)
	input [A_WIDTH-1:0] A;
	(* force_downto *)
	input [B_WIDTH-1:0] B;
	input CI, BI;
	(* force_downto *)
	output [Y_WIDTH-1:0] X, Y, CO;

	// LUTs do as well for so few.
	wire _TECHMAP_FAIL_ = Y_WIDTH <= 4;

	(* force_downto *)
	wire [Y_WIDTH-1:0] A_full, B_full;
	\$pos #(.A_SIGNED(A_SIGNED), .A_WIDTH(A_WIDTH), .Y_WIDTH(Y_WIDTH)) extend_a (.A(A), .Y(A_full));
	\$pos #(.A_SIGNED(B_SIGNED), .A_WIDTH(B_WIDTH), .Y_WIDTH(Y_WIDTH)) extend_b (.A(B), .Y(B_full));

	// The first slot is bit 0: else it is one before.
	localparam KNOWN = _TECHMAP_CONSTMSK_CI_ && _TECHMAP_CONSTMSK_BI_
		&& !(Y_WIDTH % 2 && !_TECHMAP_CONSTVAL_BI_);
	localparam SHIFT = KNOWN ? 0 : 1;
	localparam TOP = Y_WIDTH + SHIFT; // the slot that brings out the carry
	localparam SLOTS = (TOP + 2) / 2 * 2; // a CCU2C has two

	(* force_downto *)
	wire [SLOTS-1:0] a, b, s;
	(* force_downto *)
	wire [SLOTS:0] c;
	assign a = KNOWN ? A_full : {A_full, CI};
	assign b = KNOWN ? B_full : {B_full, 1'b0};

	// The carry of the first slot, of A and B: of bit 0 with CI, or A.
	localparam [3:0] GENERATE = !KNOWN ? 4'b1010 :
		_TECHMAP_CONSTVAL_BI_ ? (_TECHMAP_CONSTVAL_CI_ ? 4'b1011 : 4'b0010) : (_TECHMAP_CONSTVAL_CI_ ? 4'b1110 : 4'b1000);

	genvar i;
	generate
		CCU2C #(
			.INIT0({12'h000, GENERATE}), .INIT1(16'h96AA), .INJECT1_0("NO"), .INJECT1_1("NO")
		) first (
			.A0(a[0]), .B0(b[0]), .C0(1'b1), .D0(1'b1),
			.A1(a[1]), .B1(b[1]), .C1(BI), .D1(1'b1), .S1(s[1]), .COUT(c[2])
		);
		for (i = 2; i < SLOTS; i = i + 2) begin:slice
			CCU2C #(
				.INIT0(16'h96AA), .INIT1(16'h96AA), .INJECT1_0("NO"), .INJECT1_1("NO")
			) next (
				.CIN(c[i]),
				.A0(a[i]), .B0(b[i]), .C0(i < TOP && BI), .D0(1'b1), .S0(s[i]),
				.A1(a[i+1]), .B1(b[i+1]), .C1(i + 1 < TOP && BI), .D1(1'b1), .S1(s[i+1]),
				.COUT(c[i+2])
			);
		end
		for (i = 0; i < Y_WIDTH; i = i + 1) begin:place
			assign Y[i] = i + SHIFT == 0 ? X[0] ^ CI : s[i + SHIFT];
			if (i == Y_WIDTH - 1)
				assign CO[i] = s[TOP];
			else
				assign CO[i] = Y[i + 1] ^ X[i + 1];
		end
	endgenerate
	assign X = A_full ^ (B_full ^ {Y_WIDTH{BI}});
endmodule
