// binary32 add (IEEE 754-2008): round to nearest even, subnormal numbers are zero (inputs and results), every NaN is
// 7FC00000. One result a clock; latency 5, or 6 with DEEP, which packs the rounded sum in a stage of its own.
module fp32_add #(
    parameter bit DEEP = 1'b1
) (
    input  logic        clk,
    input  logic [31:0] a,
    input  logic [31:0] b,
    output logic [31:0] y
);
  // Ordered by magnitude.
  wire        swap = b[30:0] > a[30:0];
  wire [31:0] h = swap ? b : a;
  wire [31:0] l = swap ? a : b;
  wire        l_zero = (l[30:23] == 8'd0), h_zero = (h[30:23] == 8'd0);
  wire [7:0]  apart = h[30:23] - l[30:23];
  logic        s1, minus1, nan1, inf1;
  logic [7:0]  e1;
  logic [4:0]  d1;
  logic [23:0] h1, l1;
  always_ff @(posedge clk) begin
    s1     <= (h_zero & l_zero) ? (h[31] & l[31]) : h[31];
    minus1 <= h[31] ^ l[31];
    e1     <= h[30:23];
    d1     <= (apart > 8'd31) ? 5'd31 : apart[4:0];
    h1     <= h_zero ? 24'd0 : {1'b1, h[22:0]};
    l1     <= l_zero ? 24'd0 : {1'b1, l[22:0]};
    inf1   <= &h[30:23];
    nan1   <= (&h[30:23]) & ((|h[22:0]) | ((&l[30:23]) & (h[31] ^ l[31])));
  end

  // Aligned, with guard, round and sticky bits.
  logic        s2, minus2, nan2, inf2;
  logic [7:0]  e2;
  logic [23:0] h2;
  logic [26:0] l2;
  wire [26:0] whole = {l1, 3'd0};
  wire [26:0] shifted = whole >> d1;
  wire [26:0] lost = ~(27'h7FF_FFFF << d1) & whole;
  always_ff @(posedge clk) begin
    {s2, minus2, nan2, inf2, e2, h2} <= {s1, minus1, nan1, inf1, e1, h1};
    l2 <= {shifted[26:1], shifted[0] | (|lost)};
  end

  // Added or subtracted.
  logic        s3, nan3, inf3, minus3;
  logic [7:0]  e3;
  logic [27:0] r3;
  always_ff @(posedge clk) begin
    {s3, minus3, nan3, inf3, e3} <= {s2, minus2, nan2, inf2, e2};
    r3 <= minus2 ? ({1'b0, h2, 3'd0} - {1'b0, l2}) : ({1'b0, h2, 3'd0} + {1'b0, l2});
  end

  // Normalised: leading zeros by binary search, all but its last step.
  logic [27:0] n0, n1, n2, n3;
  logic [4:1]  zeros;
  always_comb begin
    zeros[4] = ~|r3[27:12]; n0 = zeros[4] ? {r3[11:0], 16'd0} : r3;
    zeros[3] = ~|n0[27:20]; n1 = zeros[3] ? {n0[19:0], 8'd0}  : n0;
    zeros[2] = ~|n1[27:24]; n2 = zeros[2] ? {n1[23:0], 4'd0}  : n1;
    zeros[1] = ~|n2[27:26]; n3 = zeros[1] ? {n2[25:0], 2'd0}  : n2;
  end
  logic        s4, nan4, inf4, none4;
  logic [7:0]  e4;
  logic [4:1]  z4;
  logic [27:0] n4;
  always_ff @(posedge clk) begin
    {nan4, inf4, e4, z4, n4} <= {nan3, inf3, e3, zeros, n3};
    none4 <= ~|r3;
    s4 <= s3 & ~(minus3 & ~(|r3));  // x - x = +0
  end

  // The last step, and rounded.
  wire        more = ~n4[27];
  wire [26:0] m = more ? n4[26:0] << 1 : n4[26:0];  // without the leading one
  wire        up = m[3] & (m[4] | (|m[2:0]));
  logic        s5, nan5, inf5, none5, low, over;
  logic [7:0]  e5;
  logic [22:0] m5;
  generate
    if (DEEP) begin : deep
      // What the fraction carries out goes to the exponent in the next stage.
      logic [23:0] r5;
      logic [9:0]  x5;
      always_ff @(posedge clk) begin
        {s5, nan5, inf5, none5} <= {s4, nan4, inf4, none4};
        r5 <= {1'b0, m[26:4]} + {23'd0, up};
        x5 <= {2'b00, e4} + 10'd1 - {5'd0, z4, more};
      end
      wire [9:0] x = x5 + {9'd0, r5[23]};
      assign e5 = x[7:0];
      assign m5 = r5[22:0];
      assign low = x[9] | (x == 10'd0);
      assign over = ~x[9] & (x >= 10'd255);
    end else begin : shallow
      // The exponent less one, as it is, and with one more, of which the fraction chooses.
      logic [29:0] more4;
      always_ff @(posedge clk) more4 <= {10'(e3) + 10'd2, 10'(e3) + 10'd1, 10'(e3)};
      logic [29:0] x;
      logic [2:0]  low_, high_;
      always_comb
        for (int k = 0; k < 3; k = k + 1) begin
          x[10*k +: 10] = more4[10*k +: 10] - {5'd0, z4, 1'b0};
          low_[k] = x[10*k + 9] | (x[10*k +: 10] == 10'd0);
          high_[k] = ~x[10*k + 9] & (x[10*k +: 10] >= 10'd255);
        end
      wire carry = up & (&m[26:4]);
      wire less = more & ~carry, above = ~more & carry;
      always_comb begin
        {s5, nan5, inf5, none5} = {s4, nan4, inf4, none4};
        m5 = m[26:4] + {22'd0, up};
        e5 = above ? x[27:20] : less ? x[7:0] : x[17:10];
        low = above ? low_[2] : less ? low_[0] : low_[1];
        over = above ? high_[2] : less ? high_[0] : high_[1];
      end
    end
  endgenerate

  // Packed.
  wire zero = none5 | low;
  always_ff @(posedge clk) begin
    y[31]    <= ~nan5 & s5;
    y[30:23] <= (nan5 | inf5 | (over & ~zero)) ? 8'hFF : zero ? 8'd0 : e5;
    y[22]    <= nan5 | (m5[22] & ~(inf5 | zero | over));
    y[21:0]  <= (nan5 | inf5 | zero | over) ? 22'd0 : m5[21:0];
  end
endmodule
