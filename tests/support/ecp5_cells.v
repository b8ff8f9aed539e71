// Models of cells of an ECP5 for which Yosys has none, as far as netlists of this project use them. Their pins are buses
// here; `tests/support/ecp5_cells.py` puts the cells' own pins around them.
//
// Source: Lattice FPGA-TN-02204, "ECP5 and ECP5-5G Memory Usage Guide", and FPGA-TN-02205, "ECP5 and ECP5-5G sysDSP Usage
// Guide"; where bits are in INITVALs, and that DIA and DOA have the lower half of 36, is as Yosys maps memories.

// Both ports have one width, 4, 9, 18 or 36 bits; with 36, A writes and B reads, on the pins of both.
//
// What one port reads while the other writes it, in the same clock, is inverted: hardware promises nothing.
module dp16kd (
	input [17:0] DIA, DIB,
	input [13:0] ADA, ADB,
	input [2:0] CSA, CSB,
	input CEA, OCEA, WEA, RSTA, CLKA, CEB, OCEB, WEB, RSTB, CLKB,
	output [17:0] DOA, DOB
);
	parameter [20479:0] INIT = 0;
	parameter DATA_WIDTH_A = 18, DATA_WIDTH_B = 18;
	parameter REGMODE_A = "NOREG", REGMODE_B = "NOREG";
	parameter WRITEMODE_A = "NORMAL", WRITEMODE_B = "NORMAL";
	parameter CLKAMUX = "CLKA", CLKBMUX = "CLKB";
	parameter CSDECODE_A = "0b000", CSDECODE_B = "0b000";

	localparam WIDTH = DATA_WIDTH_A;
	localparam LOW = WIDTH == 36 ? 5 : WIDTH == 18 ? 4 : WIDTH == 9 ? 3 : 2; // an address's first bit
	localparam BYTE = WIDTH < 9 ? WIDTH : 9;
	localparam WORDS = 1 << (14 - LOW);

	reg [WIDTH-1:0] memory [0:WORDS-1];
	integer n;
	initial begin
		if (DATA_WIDTH_A != DATA_WIDTH_B || CLKAMUX != "CLKA" || CLKBMUX != "CLKB" || CSDECODE_A != "0b000"
				|| CSDECODE_B != "0b000" || (WIDTH != 4 && WIDTH != 9 && WIDTH != 18 && WIDTH != 36) || (WIDTH == 4 && INIT != 0))
			$fatal(1, "tests/support/ecp5_cells.v has no model of this DP16KD");
		// Each 20 bits of INIT are 18 of data.
		for (n = 0; n < WORDS; n = n + 1)
			if (WIDTH == 36)
				memory[n] = {INIT[40*n+20 +: 18], INIT[40*n +: 18]};
			else
				memory[n] = INIT[20*(n*WIDTH/18) + n*WIDTH%18 +: WIDTH];
	end

	wire [13-LOW:0] at_a = ADA[13:LOW], at_b = ADB[13:LOW];
	wire [35:0] in_a = {DIB, DIA};
	// The lowest bits of the address of 18 and 36 bits say which bytes are written.
	wire [3:0] bytes_a = WIDTH < 18 ? 4'b1 : ADA[3:0], bytes_b = WIDTH < 18 ? 4'b1 : ADB[3:0];
	wire on_a = CEA && CSA == 0, on_b = CEB && CSB == 0;
	wire meets_a = at_a == at_b && on_a && WEA && bytes_a != 0, meets_b = at_a == at_b && on_b && WEB && bytes_b != 0;
	reg [WIDTH-1:0] read_a = 0, read_b = 0, kept_a = 0, kept_b = 0;

	always @(posedge CLKA) begin
		if (RSTA)
			read_a <= 0;
		else if (on_a && (!WEA || WRITEMODE_A == "READBEFOREWRITE"))
			read_a <= meets_b ? ~memory[at_a] : memory[at_a];
		else if (on_a && WRITEMODE_A == "WRITETHROUGH")
			read_a <= in_a[WIDTH-1:0];
		if (RSTA || OCEA)
			kept_a <= RSTA ? 0 : read_a;
		for (n = 0; n < WIDTH / BYTE; n = n + 1)
			if (on_a && WEA && bytes_a[n])
				memory[at_a][BYTE*n +: BYTE] <= in_a[BYTE*n +: BYTE];
	end

	always @(posedge CLKB) begin
		if (RSTB)
			read_b <= 0;
		else if (on_b && (!WEB || WRITEMODE_B == "READBEFOREWRITE"))
			read_b <= meets_a ? ~memory[at_b] : memory[at_b];
		else if (on_b && WRITEMODE_B == "WRITETHROUGH")
			read_b <= DIB[WIDTH-1:0];
		if (RSTB || OCEB)
			kept_b <= RSTB ? 0 : read_b;
		for (n = 0; n < WIDTH / BYTE; n = n + 1)
			if (on_b && WEB && bytes_b[n])
				memory[at_b][BYTE*n +: BYTE] <= DIB[BYTE*n +: BYTE];
	end

	wire [35:0] out_a = REGMODE_A == "OUTREG" ? kept_a : read_a;
	wire [35:0] out_b = REGMODE_B == "OUTREG" ? kept_b : read_b;
	assign DOA = WIDTH == 36 ? out_b[17:0] : out_a[17:0];
	assign DOB = WIDTH == 36 ? out_b[35:18] : out_b[17:0];
endmodule

// With registers on the factors and on the product, all of CLK0, or without.
module mult18x18d (
	input [17:0] A, B,
	input SIGNEDA, SIGNEDB, SOURCEA, SOURCEB, CLK0, CE0, RST0,
	output [35:0] P
);
	parameter REG_INPUTA_CLK = "NONE", REG_INPUTB_CLK = "NONE", REG_OUTPUT_CLK = "NONE";

	wire signed [18:0] a = {SIGNEDA && A[17], A}, b = {SIGNEDB && B[17], B};
	reg signed [18:0] kept_a = 0, kept_b = 0;
	wire signed [37:0] product = (REG_INPUTA_CLK == "NONE" ? a : kept_a) * (REG_INPUTB_CLK == "NONE" ? b : kept_b);
	reg [35:0] kept = 0;
	always @(posedge CLK0)
		if (RST0 || CE0) begin
			kept_a <= RST0 ? 0 : a;
			kept_b <= RST0 ? 0 : b;
			kept <= RST0 ? 0 : product[35:0];
		end
	assign P = REG_OUTPUT_CLK == "NONE" ? product[35:0] : kept;
endmodule
