/* A bare timer loop in C: sleep until each deadline, note how late it woke. */
#include <errno.h>
#include <stdint.h>
#include <time.h>

#define NS_PER_S 1000000000LL

static int64_t monotonic_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * NS_PER_S + now.tv_nsec;
}

void run_timer(int64_t first_deadline_ns, int64_t period_ns, int64_t *lateness_ns, int64_t ticks)
{
    int64_t deadline_ns = first_deadline_ns;
    for (int64_t tick = 0; tick < ticks; tick++) {
        struct timespec deadline = {deadline_ns / NS_PER_S, deadline_ns % NS_PER_S};
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &deadline, NULL) == EINTR) {
        }
        int64_t woke_ns = monotonic_ns();
        lateness_ns[tick] = woke_ns - deadline_ns;
        /* missed deadlines are skipped, as in the loop */
        int64_t missed = (woke_ns - deadline_ns) / period_ns;
        deadline_ns += (missed + 1) * period_ns;
    }
}
