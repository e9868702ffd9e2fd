/* Made by hw/registers.py from vsense_ros/accelerator/registers.py. */
#ifndef VSENSE_REGISTERS_H
#define VSENSE_REGISTERS_H
#define VSENSE_CONTROL 0x00u /* start and state */
#define VSENSE_CONTROL_START 0x1u /* write 1: take one request; reads 1 until it has been taken in */
#define VSENSE_CONTROL_DONE 0x2u /* the result has left; reading clears it */
#define VSENSE_CONTROL_IDLE 0x4u /* no request is worked on */
#define VSENSE_CONTROL_READY 0x8u /* the request was taken in; reading clears it */
#define VSENSE_CONTROL_AUTO_RESTART 0x80u /* start again as soon as a request was taken in */
#define VSENSE_CONTROL_ABORT 0x10000u /* write 1: give up the request that is taken in or computed */
#define VSENSE_CONTROL_SOFT_RESET 0x20000u /* write 1: as the reset of the hardware, but for this bus */
#define VSENSE_GLOBAL_INTERRUPT 0x04u /* interrupts at all */
#define VSENSE_GLOBAL_INTERRUPT_ENABLE 0x1u /* interrupts leave */
#define VSENSE_INTERRUPT_ENABLE 0x08u /* which events interrupt */
#define VSENSE_INTERRUPT_ENABLE_DONE 0x1u /* result has left */
#define VSENSE_INTERRUPT_ENABLE_READY 0x2u /* request was taken in */
#define VSENSE_INTERRUPT_STATUS 0x0cu /* events since they were cleared by writing 1 */
#define VSENSE_INTERRUPT_STATUS_DONE 0x1u /* result has left */
#define VSENSE_INTERRUPT_STATUS_READY 0x2u /* request was taken in */
#define VSENSE_KERNEL 0x10u /* number of the kernel, as in a frame */
#define VSENSE_MAP_VERSION 0x14u /* version of this list */
#define VSENSE_SIZE 0x18u /* rows of a matrix, or 0 */
#define VSENSE_WORDS_IN 0x1cu /* of a request; 0: a program, as long as it says */
#define VSENSE_WORDS_OUT 0x20u /* of a result; 0: as many as the program asks for */
#define VSENSE_TABLE_WORDS 0x24u /* of coefficients, or 0 */
#define VSENSE_MODE 0x28u /* what the next start takes in */
#define VSENSE_MODE_TABLE 0x1u /* coefficients */
#define VSENSE_STATUS 0x2cu /* of the last packet: 0, 1 pivot or number refused, 6 given up or no coefficients, 7 wrong length */
#define VSENSE_COMPUTE_CYCLES 0x30u /* clocks of the last computation */
#define VSENSE_LINK_CYCLES 0x34u /* clocks of the last request but those: words that came, left or were awaited */
#define VSENSE_REQUESTS 0x38u /* results that have left since the reset */
#define VSENSE_ABORTED 0x3cu /* requests that were given up since the reset */
#define VSENSE_MALFORMED 0x40u /* packets of a wrong length since the reset */
#define VSENSE_KERNEL_SOLVE14 1u
#define VSENSE_KERNEL_SOLVE42 2u
#define VSENSE_KERNEL_BODY_MASS 3u
#define VSENSE_KERNEL_SUSPENSION_MOTION 4u
#define VSENSE_KERNEL_ROW_COMBINER 5u
#define VSENSE_KERNEL_SOLVE56 6u
#endif
