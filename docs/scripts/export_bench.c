/* Counts the instructions of a step on a Cortex-M7 in QEMU (`mps2-an500`, `-icount shift=0`: one instruction takes a
   nanosecond of its clock), for docs/scripts/export_bench.py. NAME is that of the controller; rows.h has readings along its reference.

   The processor's timer counts at 25 MHz, so a count is 40 instructions. */
#include <stdint.h>

#define PASTE(a, b) a##b
#define JOIN(a, b) PASTE(a, b)
#define TEXT(a) #a
#define QUOTED(a) TEXT(a)
#include QUOTED(HEADER)
#include "rows.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))

static struct JOIN(NAME, _controller) controller;
extern uint32_t stack_top, data_start, data_end, data_from, bss_start, bss_end;
void start(void);

__attribute__((section(".vectors"), used)) static const void *const vectors[2] = {&stack_top, (const void *)start};

static void say(const char *text)
{
    register int operation __asm("r0") = 4; /* SYS_WRITE0 */
    register const char *what __asm("r1") = text;
    __asm volatile("bkpt 0xab" : "+r"(operation) : "r"(what) : "memory");
}

static void say_number(uint32_t number)
{
    char text[12], *at = &text[11];
    *at = 0;
    *--at = '\n';
    do {
        *--at = (char)('0' + number % 10u);
        number /= 10u;
    } while (number);
    say(at);
}

static void leave(void)
{
    register int operation __asm("r0") = 0x18; /* SYS_EXIT */
    register int reason __asm("r1") = 0x20026;
    __asm volatile("bkpt 0xab" : : "r"(operation), "r"(reason));
    for (;;) {
    }
}

static void __attribute__((noinline)) measure(void)
{
    double command[6];
    uint64_t sum = 0;
    uint32_t most = 0;
    for (uint32_t *from = &data_from, *to = &data_start; to < &data_end;) *to++ = *from++;
    for (uint32_t *to = &bss_start; to < &bss_end;) *to++ = 0;
    REGISTER(0xE000E014) = 0xFFFFFF;
    REGISTER(0xE000E018) = 0;
    REGISTER(0xE000E010) = 5;
    JOIN(NAME, _init)(&controller);
    for (int k = 0; k < ROWS; k++) {
        const double *row = rows[k];
        const uint32_t before = REGISTER(0xE000E018);
        const int status = JOIN(NAME, _step)(&controller, row, row + READING, 0.0, command);
        const uint32_t taken = (before - REGISTER(0xE000E018)) & 0xFFFFFF;
        sum += taken;
        most = taken > most ? taken : most;
        for (int n = 0; n < 6; n++) {
            const double off = command[n] - row[READING + REFERENCE + 1 + n];
            if (status != 0 || !(off < 1e-9 && off > -1e-9)) {
                say("differs\n");
                leave();
            }
        }
    }
    say_number((uint32_t)(40u * sum / ROWS));
    say_number(40u * most);
    leave();
}

void start(void)
{
    REGISTER(0xE000ED88) |= 0xFu << 20; /* the floating-point unit, before anything uses it */
    __asm volatile("dsb\nisb");
    measure();
}
