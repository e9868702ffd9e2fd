// a0 b0 + a1 b1 + a2 b2, each operation rounded, in this order. One result a clock; latency that of a product and two
// sums: 13, or 17 with DEEP.
module dot3 #(
    parameter bit DEEP = 1'b0
) (
    input  logic        clk,
    input  logic [95:0] a,  // a2, a1, a0
    input  logic [95:0] b,
    output logic [31:0] y
);
  localparam int LA = DEEP ? 6 : 5;
  wire [31:0] p0, p1, p2, s;
  fp32_mul #(.DEEP(DEEP)) u_p0 (.clk, .a(a[31:0]), .b(b[31:0]), .y(p0));
  fp32_mul #(.DEEP(DEEP)) u_p1 (.clk, .a(a[63:32]), .b(b[63:32]), .y(p1));
  fp32_mul #(.DEEP(DEEP)) u_p2 (.clk, .a(a[95:64]), .b(b[95:64]), .y(p2));
  fp32_add #(.DEEP(DEEP)) u_s (.clk, .a(p0), .b(p1), .y(s));
  logic [31:0] later [1:LA];
  always_ff @(posedge clk) begin
    later[1] <= p2;
    for (int i = 2; i <= LA; i = i + 1) later[i] <= later[i-1];
  end
  fp32_add #(.DEEP(DEEP)) u_y (.clk, .a(s), .b(later[LA]), .y(y));
endmodule
