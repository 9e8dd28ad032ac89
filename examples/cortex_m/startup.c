/* What a Cortex-M4 with a floating-point unit needs before main: the vector table, the unit switched on, data in RAM. */

#include <stdint.h>

extern uint32_t data_in_flash, data_begin, data_end, bss_begin, bss_end, stack_top;
extern void initialise_monitor_handles(void);
int main(void);
void _exit(int code);

static void stop(void)
{
    for (;;) {
    }
}

void reset(void)
{
    /* Full access to coprocessors 10 and 11, the floating-point unit (CPACR). */
    *(volatile uint32_t *)0xE000ED88 |= 0xFu << 20;
    __asm__ volatile("dsb\n\tisb");
    const uint32_t *from = &data_in_flash;
    for (uint32_t *to = &data_begin; to < &data_end;) *to++ = *from++;
    for (uint32_t *to = &bss_begin; to < &bss_end;) *to++ = 0;
#ifdef SEMIHOSTING
    initialise_monitor_handles();
#endif
    _exit(main());
}

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    &stack_top, (const void *)reset, (const void *)stop, (const void *)stop, (const void *)stop, (const void *)stop, (const void *)stop,
};
