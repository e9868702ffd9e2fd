// binary32 multiply (IEEE 754-2008): round to nearest even, subnormal numbers are zero (inputs and results), every NaN
// is 7FC00000. One result a clock; latency 3, or 5 with DEEP, which splits the rounding for a higher clock.
module fp32_mul #(
    parameter bit DEEP = 1'b1
) (
    input  logic        clk,
    input  logic [31:0] a,
    input  logic [31:0] b,
    output logic [31:0] y
);
  wire a_zero = (a[30:23] == 8'd0), b_zero = (b[30:23] == 8'd0);
  wire a_top = &a[30:23], b_top = &b[30:23];

  // Partial products, 24 × 17 and 24 × 7: one DSP48E1 each.
  logic        s1, nan1, inf1, zero1;
  logic [9:0]  e1;
  logic [40:0] low1;
  logic [30:0] high1;
  always_ff @(posedge clk) begin
    s1    <= a[31] ^ b[31];
    e1    <= {2'b00, a[30:23]} + {2'b00, b[30:23]} - 10'd127;
    zero1 <= a_zero | b_zero;
    inf1  <= a_top | b_top;
    nan1  <= (a_top & (|a[22:0])) | (b_top & (|b[22:0])) | (a_top & b_zero) | (b_top & a_zero);
    low1  <= {1'b1, a[22:0]} * b[16:0];
    high1 <= {1'b1, a[22:0]} * {1'b1, b[22:17]};
  end

  // Their sum.
  logic        s2, nan2, inf2, zero2;
  logic [9:0]  e2;
  logic [47:0] p2;
  always_ff @(posedge clk) begin
    {s2, nan2, inf2, zero2, e2} <= {s1, nan1, inf1, zero1, e1};
    p2 <= {high1, 17'd0} + {7'd0, low1};
  end

  // Normalised, and whether to round up.
  wire         top = p2[47];
  wire  [22:0] fraction = top ? p2[46:24] : p2[45:23];
  wire         half = top ? p2[23] : p2[22];
  wire         rest = top ? (|p2[22:0]) : (|p2[21:0]);
  wire         up = half & (rest | fraction[0]);

  logic        s3, nan3, inf3, zero3, up3;
  logic [9:0]  e3;
  logic [22:0] m3;
  logic        s4, nan4, inf4, zero4;
  logic [32:0] r4;
  generate
    if (DEEP) begin : deep
      always_ff @(posedge clk) begin
        {s3, nan3, inf3, zero3} <= {s2, nan2, inf2, zero2};
        e3  <= e2 + {9'd0, top};
        m3  <= fraction;
        up3 <= up;
        {s4, nan4, inf4, zero4} <= {s3, nan3, inf3, zero3};
        // A carry out of the fraction increments the exponent, as it should.
        r4  <= {e3, m3} + {32'd0, up3};
      end
    end else begin : shallow
      always_comb begin
        {s3, nan3, inf3, zero3} = {s2, nan2, inf2, zero2};
        e3  = e2 + {9'd0, top};
        m3  = fraction;
        up3 = up;
        {s4, nan4, inf4, zero4} = {s3, nan3, inf3, zero3};
        r4  = {e3, m3} + {32'd0, up3};
      end
    end
  endgenerate

  // Packed.
  wire [9:0] e4 = r4[32:23];
  wire       under = e4[9] | (e4 == 10'd0);
  wire       over = ~e4[9] & (e4 >= 10'd255);
  always_ff @(posedge clk) begin
    y[31]    <= ~nan4 & s4;
    y[30:23] <= (nan4 | inf4) ? 8'hFF : (zero4 | under) ? 8'd0 : over ? 8'hFF : r4[30:23];
    y[22]    <= nan4 | (r4[22] & ~(inf4 | zero4 | under | over));
    y[21:0]  <= (nan4 | inf4 | zero4 | under | over) ? 22'd0 : r4[21:0];
  end
endmodule
