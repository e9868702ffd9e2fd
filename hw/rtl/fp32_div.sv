// binary32 divide (IEEE 754-2008): round to nearest even, subnormal numbers are zero (inputs and results), every NaN is
// 7FC00000. One result a clock; latency 15, two bits of the quotient in each of 13 stages, or 16 with DEEP.
module fp32_div #(
    parameter bit DEEP = 1'b1
) (
    input  logic        clk,
    input  logic [31:0] a,
    input  logic [31:0] b,
    output logic [31:0] y
);
  localparam int S = 13;
  wire a_zero = (a[30:23] == 8'd0), b_zero = (b[30:23] == 8'd0);
  wire a_top = &a[30:23], b_top = &b[30:23];
  wire less = a[22:0] < b[22:0];
  logic [25:0] r [0:S];   // remainder
  logic [23:0] d [0:S];   // divisor
  logic [25:0] q [0:S];   // quotient
  logic [13:0] side [0:S]; // sign, NaN, infinite, zero, exponent
  always_ff @(posedge clk) begin
    r[0] <= less ? {1'b0, 1'b1, a[22:0], 1'b0} : {2'b00, 1'b1, a[22:0]};
    d[0] <= {1'b1, b[22:0]};
    q[0] <= 26'd0;
    side[0] <= {a[31] ^ b[31],
                (a_top & (|a[22:0])) | (b_top & (|b[22:0])) | (a_top & b_top) | (a_zero & b_zero),
                a_top | b_zero, a_zero | b_top,
                {2'b00, a[30:23]} - {2'b00, b[30:23]} + 10'd127 - {9'd0, less}};
  end
  genvar i;
  generate
    for (i = 0; i < S; i = i + 1) begin : digit
      wire [25:0] t1 = r[i] - {2'b00, d[i]};
      wire        q1 = ~t1[25];
      wire [25:0] r1 = q1 ? {t1[24:0], 1'b0} : {r[i][24:0], 1'b0};
      wire [25:0] t2 = r1 - {2'b00, d[i]};
      wire        q2 = ~t2[25];
      wire [25:0] r2 = q2 ? {t2[24:0], 1'b0} : {r1[24:0], 1'b0};
      always_ff @(posedge clk) begin
        r[i+1] <= r2;
        d[i+1] <= d[i];
        q[i+1] <= {q[i][23:0], q1, q2};
        side[i+1] <= side[i];
      end
    end
  endgenerate

  // Rounded.
  wire         up = q[S][1] & (q[S][2] | q[S][0] | (|r[S]));
  wire  [32:0] sum = {side[S][9:0], q[S][24:2]} + {32'd0, up};
  logic        s, nan, inf, zero;
  logic [32:0] er;
  generate
    if (DEEP) begin : deep
      always_ff @(posedge clk) begin
        {s, nan, inf, zero} <= side[S][13:10];
        er <= sum;
      end
    end else begin : shallow
      always_comb begin
        {s, nan, inf, zero} = side[S][13:10];
        er = sum;
      end
    end
  endgenerate

  // Packed.
  wire [9:0] e = er[32:23];
  wire       under = e[9] | (e == 10'd0);
  wire       over = ~e[9] & (e >= 10'd255);
  wire       nothing = zero | under;
  always_ff @(posedge clk) begin
    y[31]    <= ~nan & s;
    y[30:23] <= (nan | inf) ? 8'hFF : nothing ? 8'd0 : over ? 8'hFF : er[30:23];
    y[22]    <= nan | (er[22] & ~(inf | nothing | over));
    y[21:0]  <= (nan | inf | nothing | over) ? 22'd0 : er[21:0];
  end
endmodule
