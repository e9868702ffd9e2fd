// One property of each unit: a sum does not change when its operands are exchanged; a number times one
// is that number, with one pattern for every NaN and zero for subnormal numbers; over zero, subnormal numbers among it, a
// number is infinite with the right sign, zero and NaN are NaN.
module formal_add (input logic clk, input logic [31:0] a, input logic [31:0] b);
  logic [31:0] x, y;
  fp32_add one (.clk, .a(a), .b(b), .y(x));
  fp32_add other (.clk, .a(b), .b(a), .y(y));
  logic [3:0] age = '0;
  always_ff @(posedge clk) begin
    if (age < 4'd8) age <= age + 1'b1;
    if (age >= 4'd7) assert (x == y);
  end
endmodule

module formal_mul (input logic clk, input logic [31:0] a, input logic [31:0] b);
  logic [31:0] y;
  logic [31:0] before [0:4];
  fp32_mul unit (.clk, .a(a), .b({1'b0, 8'd127, 23'd0}), .y(y));
  logic [3:0] age = '0;
  always_ff @(posedge clk) begin
    before[0] <= a;
    for (int i = 1; i < 5; i = i + 1) before[i] <= before[i-1];
    if (age < 4'd8) age <= age + 1'b1;
    if (age >= 4'd7)
      if (&before[4][30:23] & (|before[4][22:0])) assert (y == 32'h7FC0_0000);
      else if (before[4][30:23] == 8'd0) assert (y == {before[4][31], 31'd0});
      else assert (y == before[4]);
  end
endmodule

module formal_div (input logic clk, input logic [31:0] a, input logic [31:0] b);
  logic [31:0] y;
  logic [31:0] before [0:15];
  logic        negative [0:15];
  fp32_div unit (.clk, .a(a), .b({b[31], 8'd0, b[22:0]}), .y(y));
  logic [4:0] age = '0;
  always_ff @(posedge clk) begin
    before[0] <= a;
    negative[0] <= a[31] ^ b[31];
    for (int i = 1; i < 16; i = i + 1) begin
      before[i] <= before[i-1];
      negative[i] <= negative[i-1];
    end
    if (age < 5'd18) age <= age + 1'b1;
    if (age >= 5'd17)
      if ((before[15][30:23] == 8'd0) | (&before[15][30:23] & (|before[15][22:0]))) assert (y == 32'h7FC0_0000);
      else assert (y == {negative[15], 8'hFF, 23'd0});
  end
endmodule
