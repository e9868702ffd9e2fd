// A kernel behind its registers as a shared library: what a processor and its DMA do.
#include "Vcontrolled_kernel.h"
#include "verilated.h"
#include <cstdint>

namespace {
struct Instance {
  VerilatedContext context;
  Vcontrolled_kernel top{&context};
};

void tick(Instance* instance) {
  instance->top.clk = 0;
  instance->top.eval();
  instance->top.clk = 1;
  instance->top.eval();
}

void settle(Instance* instance) {
  instance->top.clk = 0;
  instance->top.eval();
}
}  // namespace

extern "C" {
Instance* kernel_new() {
  Instance* instance = new Instance;
  instance->top.rst_n = 0;
  for (int i = 0; i < 40; i++) tick(instance);
  instance->top.rst_n = 1;
  tick(instance);
  return instance;
}

void kernel_delete(Instance* instance) {
  instance->top.final();
  delete instance;
}

// `order`: 0 address and data at once, 1 the address first, 2 the data first.
void kernel_write(Instance* instance, uint32_t address, uint32_t data, int order) {
  auto& top = instance->top;
  top.s_axi_awaddr = address;
  top.s_axi_wdata = data;
  bool address_left = true, data_left = true;
  top.s_axi_bready = 1;
  for (int i = 0; address_left || data_left; i++) {
    top.s_axi_awvalid = address_left && (order != 2 || i > 2);
    top.s_axi_wvalid = data_left && (order != 1 || i > 2);
    settle(instance);
    bool took_address = top.s_axi_awvalid && top.s_axi_awready, took_data = top.s_axi_wvalid && top.s_axi_wready;
    tick(instance);
    if (took_address) address_left = false;
    if (took_data) data_left = false;
  }
  top.s_axi_awvalid = top.s_axi_wvalid = 0;
  for (settle(instance); !top.s_axi_bvalid; settle(instance)) tick(instance);
  tick(instance);
  top.s_axi_bready = 0;
}

uint32_t kernel_read(Instance* instance, uint32_t address) {
  auto& top = instance->top;
  top.s_axi_araddr = address;
  top.s_axi_arvalid = 1;
  top.s_axi_rready = 1;
  for (settle(instance); !top.s_axi_arready; settle(instance)) tick(instance);
  tick(instance);
  top.s_axi_arvalid = 0;
  for (settle(instance); !top.s_axi_rvalid; settle(instance)) tick(instance);
  uint32_t value = top.s_axi_rdata;
  tick(instance);
  top.s_axi_rready = 0;
  return value;
}

// Offers words for so many clocks, the one at `last` marked as the last of a packet; how many were taken. A word is
// offered in every `every`-th clock only.
int kernel_offer(Instance* instance, const uint32_t* words, int count, int clocks, int every, int last) {
  auto& top = instance->top;
  int taken = 0;
  for (int i = 0; i < clocks && taken < count; i++) {
    top.s_tvalid = i % every == 0;
    top.s_tdata = words[taken];
    top.s_tlast = taken == last;
    settle(instance);
    bool took = top.s_tvalid && top.s_tready;
    tick(instance);
    if (took) taken++;
  }
  top.s_tvalid = 0;
  return taken;
}

// Takes words for so many clocks; how many came, and which of them was marked as the last.
int kernel_collect(Instance* instance, uint32_t* words, int count, int clocks, int every, int* last) {
  auto& top = instance->top;
  int came = 0;
  *last = -1;
  for (int i = 0; i < clocks && came < count; i++) {
    top.m_tready = i % every == 0;
    settle(instance);
    if (top.m_tvalid && top.m_tready) {
      if (top.m_tlast) *last = came;
      words[came++] = top.m_tdata;
    }
    tick(instance);
  }
  top.m_tready = 0;
  return came;
}

void kernel_clocks(Instance* instance, int count) {
  for (int i = 0; i < count; i++) tick(instance);
}

// A reset of so many clocks.
void kernel_reset(Instance* instance, int clocks) {
  instance->top.rst_n = 0;
  instance->top.s_tvalid = 0;
  for (int i = 0; i < clocks; i++) tick(instance);
  instance->top.rst_n = 1;
}

int kernel_irq(Instance* instance) {
  settle(instance);
  return instance->top.irq;
}
}
