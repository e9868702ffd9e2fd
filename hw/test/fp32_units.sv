// The three arithmetic units side by side, each with its own latency.
module fp32_units #(
    parameter bit DEEP = 1'b1
) (
    input  logic        clk,
    input  logic [31:0] a,
    input  logic [31:0] b,
    output logic [31:0] product,
    output logic [31:0] sum,
    output logic [31:0] quotient
);
  fp32_mul #(.DEEP(DEEP)) u_mul (.clk, .a, .b, .y(product));
  fp32_add #(.DEEP(DEEP)) u_add (.clk, .a, .b, .y(sum));
  fp32_div #(.DEEP(DEEP)) u_div (.clk, .a, .b, .y(quotient));
endmodule
