// Made by hw/registers.py from vsense_ros/accelerator/registers.py.
package register_map;
  localparam int ADDRESS_BITS = 7;
  localparam logic [6:0] CONTROL = 7'h00;
  localparam int CONTROL_START = 0;
  localparam int CONTROL_DONE = 1;
  localparam int CONTROL_IDLE = 2;
  localparam int CONTROL_READY = 3;
  localparam int CONTROL_AUTO_RESTART = 7;
  localparam int CONTROL_ABORT = 16;
  localparam int CONTROL_SOFT_RESET = 17;
  localparam logic [6:0] GLOBAL_INTERRUPT = 7'h04;
  localparam int GLOBAL_INTERRUPT_ENABLE = 0;
  localparam logic [6:0] INTERRUPT_ENABLE = 7'h08;
  localparam int INTERRUPT_ENABLE_DONE = 0;
  localparam int INTERRUPT_ENABLE_READY = 1;
  localparam logic [6:0] INTERRUPT_STATUS = 7'h0c;
  localparam int INTERRUPT_STATUS_DONE = 0;
  localparam int INTERRUPT_STATUS_READY = 1;
  localparam logic [6:0] KERNEL = 7'h10;
  localparam logic [6:0] MAP_VERSION = 7'h14;
  localparam logic [6:0] SIZE = 7'h18;
  localparam logic [6:0] WORDS_IN = 7'h1c;
  localparam logic [6:0] WORDS_OUT = 7'h20;
  localparam logic [6:0] TABLE_WORDS = 7'h24;
  localparam logic [6:0] MODE = 7'h28;
  localparam int MODE_TABLE = 0;
  localparam logic [6:0] STATUS = 7'h2c;
  localparam logic [6:0] COMPUTE_CYCLES = 7'h30;
  localparam logic [6:0] LINK_CYCLES = 7'h34;
  localparam logic [6:0] REQUESTS = 7'h38;
  localparam logic [6:0] ABORTED = 7'h3c;
  localparam logic [6:0] MALFORMED = 7'h40;
  function automatic int kernel_of(input int number);
    case (number)
      1: kernel_of = 1;
      2: kernel_of = 2;
      3: kernel_of = 3;
      4: kernel_of = 4;
      5: kernel_of = 5;
      6: kernel_of = 6;
      default: kernel_of = 0;
    endcase
  endfunction
  function automatic int map_version_of(input int number);
    case (number)
      1: map_version_of = 2;
      2: map_version_of = 2;
      3: map_version_of = 2;
      4: map_version_of = 2;
      5: map_version_of = 2;
      6: map_version_of = 2;
      default: map_version_of = 0;
    endcase
  endfunction
  function automatic int size_of(input int number);
    case (number)
      1: size_of = 14;
      2: size_of = 42;
      3: size_of = 0;
      4: size_of = 0;
      5: size_of = 64;
      6: size_of = 56;
      default: size_of = 0;
    endcase
  endfunction
  function automatic int words_in_of(input int number);
    case (number)
      1: words_in_of = 210;
      2: words_in_of = 1806;
      3: words_in_of = 19;
      4: words_in_of = 12;
      5: words_in_of = 0;
      6: words_in_of = 3192;
      default: words_in_of = 0;
    endcase
  endfunction
  function automatic int words_out_of(input int number);
    case (number)
      1: words_out_of = 14;
      2: words_out_of = 42;
      3: words_out_of = 9;
      4: words_out_of = 96;
      5: words_out_of = 0;
      6: words_out_of = 56;
      default: words_out_of = 0;
    endcase
  endfunction
  function automatic int table_words_of(input int number);
    case (number)
      1: table_words_of = 0;
      2: table_words_of = 0;
      3: table_words_of = 0;
      4: table_words_of = 576;
      5: table_words_of = 0;
      6: table_words_of = 0;
      default: table_words_of = 0;
    endcase
  endfunction
  localparam logic [2:0] STATUS_OK = 3'd0;
  localparam logic [2:0] STATUS_PIVOT = 3'd1;
  localparam logic [2:0] STATUS_FAULT = 3'd6;
  localparam logic [2:0] STATUS_WRONG_SIZE = 3'd7;
  // What `err` of a kernel means: a refused pivot, or no coefficients.
  function automatic logic [2:0] refusal_of(input int number);
    refusal_of = (table_words_of(number) != 0) ? STATUS_FAULT : STATUS_PIVOT;
  endfunction
endpackage
