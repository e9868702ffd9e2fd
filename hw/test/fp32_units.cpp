// Millions of operand pairs through the verilated units: results in the order of the operands.
#include "Vfp32_units.h"
#include "verilated.h"
#include <cstdint>

extern "C" void units_run(const uint32_t* a, const uint32_t* b, long count, const int* latency, uint32_t* product,
                          uint32_t* sum, uint32_t* quotient) {
  VerilatedContext context;
  Vfp32_units top{&context};
  for (long i = 0; i < count + 20; i++) {
    top.a = i < count ? a[i] : 0;
    top.b = i < count ? b[i] : 0;
    top.clk = 0;
    top.eval();
    top.clk = 1;
    top.eval();
    const uint32_t left[3] = {top.product, top.sum, top.quotient};
    uint32_t* to[3] = {product, sum, quotient};
    for (int k = 0; k < 3; k++) {
      long from = i - latency[k] + 1;
      if (from >= 0 && from < count) to[k][from] = left[k];
    }
  }
  top.final();
}
