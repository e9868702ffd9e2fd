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

  logic        s4, nan4, inf4, zero4, under, over;
  logic [7:0]  e4;
  logic [22:0] m4;
  generate
    if (DEEP) begin : deep
      logic        s3, nan3, inf3, zero3, up3;
      logic [9:0]  e3;
      logic [22:0] m3;
      logic [32:0] r4;
      always_ff @(posedge clk) begin
        {s3, nan3, inf3, zero3} <= {s2, nan2, inf2, zero2};
        e3  <= e2 + {9'd0, top};
        m3  <= fraction;
        up3 <= up;
        {s4, nan4, inf4, zero4} <= {s3, nan3, inf3, zero3};
        // A carry out of the fraction increments the exponent, as it should.
        r4  <= {e3, m3} + {32'd0, up3};
      end
      assign {e4, m4} = r4[30:0];
      assign under = r4[32] | (r4[32:23] == 10'd0);
      assign over = ~r4[32] & (r4[32:23] >= 10'd255);
    end else begin : shallow
      // The exponent as it is, and with one or two more, of which the fraction chooses.
      logic [23:0] x2;
      logic [2:0]  under2, over2;
      wire  [29:0] x1 = {e1 + 10'd2, e1 + 10'd1, e1};
      always_ff @(posedge clk)
        for (int k = 0; k < 3; k = k + 1) begin
          x2[8*k +: 8] <= x1[10*k +: 8];
          under2[k] <= x1[10*k + 9] | (x1[10*k +: 10] == 10'd0);
          over2[k] <= ~x1[10*k + 9] & (x1[10*k +: 10] >= 10'd255);
        end
      wire carry = up & (&fraction);
      wire two = top & carry, one = top ^ carry;
      always_comb begin
        {s4, nan4, inf4, zero4} = {s2, nan2, inf2, zero2};
        m4 = fraction + {22'd0, up};
        e4 = two ? x2[23:16] : one ? x2[15:8] : x2[7:0];
        under = two ? under2[2] : one ? under2[1] : under2[0];
        over = two ? over2[2] : one ? over2[1] : over2[0];
      end
    end
  endgenerate

  // Packed.
  always_ff @(posedge clk) begin
    y[31]    <= ~nan4 & s4;
    y[30:23] <= (nan4 | inf4) ? 8'hFF : (zero4 | under) ? 8'd0 : over ? 8'hFF : e4;
    y[22]    <= nan4 | (m4[22] & ~(inf4 | zero4 | under | over));
    y[21:0]  <= (nan4 | inf4 | zero4 | under | over) ? 22'd0 : m4[21:0];
  end
endmodule
