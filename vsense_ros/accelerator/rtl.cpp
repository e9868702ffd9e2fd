// A verilated kernel as a shared library: requests in, results and clocks out. TOP is the module, its header TOP_HEADER.
#include TOP_HEADER
#include "verilated.h"
#include <cstdint>

namespace {
struct Instance {
  VerilatedContext context;
  TOP top{&context};
  uint64_t clocks = 0;
};

void tick(Instance* instance) {
  instance->top.clk = 0;
  instance->top.eval();
  instance->top.clk = 1;
  instance->top.eval();
  instance->clocks++;
}
}  // namespace

extern "C" {
Instance* rtl_new() {
  Instance* instance = new Instance;
  TOP& top = instance->top;
  top.rst_n = 0;
  top.s_tvalid = 0;
  top.m_tready = 0;
  for (int i = 0; i < 40; i++) tick(instance);
  top.rst_n = 1;
  tick(instance);
  return instance;
}

void rtl_delete(Instance* instance) {
  instance->top.final();
  delete instance;
}

uint64_t rtl_clocks(Instance* instance) { return instance->clocks; }

// Feeds words for so many clocks, and then resets for one.
void rtl_cut(Instance* instance, const uint32_t* words, int count, int clocks) {
  TOP& top = instance->top;
  top.m_tready = 1;
  for (int i = 0, k = 0; i < clocks; i++) {
    top.s_tvalid = k < count;
    top.s_tdata = k < count ? words[k] : 0;
    if (top.s_tready) k++;
    tick(instance);
  }
  top.s_tvalid = 0;
  top.rst_n = 0;
  tick(instance);
  top.rst_n = 1;
  tick(instance);
}

void rtl_table(Instance* instance, const uint32_t* words, int count) {
#ifdef HAS_TABLE
  TOP& top = instance->top;
  top.s_tvalid = 1;
  top.s_tuser = 1;
  for (int i = 0; i < count; i++) {
    top.s_tdata = words[i];
    tick(instance);
  }
  top.s_tvalid = 0;
  top.s_tuser = 0;
#else
  (void)instance; (void)words; (void)count;
#endif
}

// Returns how many were finished: fewer than `count` only if one took a million clocks.
int rtl_run(Instance* instance, const uint32_t* in, int words_in, uint32_t* out, int words_out, int count,
            uint32_t* cycles, uint8_t* refused) {
  TOP& top = instance->top;
  for (int k = 0; k < count; k++) {
    const uint32_t* request = in + (long)k * words_in;
    uint32_t* result = out + (long)k * words_out;
    top.m_tready = 1;
    top.s_tvalid = 1;
    for (int i = 0; i < words_in;) {
      top.s_tdata = request[i];
      if (top.s_tready) i++;
      tick(instance);
    }
    top.s_tvalid = 0;
    int done = 0;
    for (long guard = 0; done < words_out; guard++) {
      if (guard == 1000000) return k;
      if (top.m_tvalid) {
        if (done == 0) {
          cycles[k] = top.cycles;
          refused[k] = top.err;
        }
        result[done++] = top.m_tdata;
      }
      tick(instance);
    }
  }
  return count;
}
}
