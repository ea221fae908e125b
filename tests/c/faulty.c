/* A partition without an error handler that has the fault which the macro FAULT names. */
#include <stdlib.h>

#include "partition.h"

static volatile int zero = 0, one = 1;
static volatile int *volatile nowhere = (volatile int *) 16;

static int deep(int depth) {
    volatile char frame[1024];
    frame[0] = (char) depth;
    return depth == 0 ? 0 : deep(depth + 1) + frame[0];
}

static void null_pointer(void) { *nowhere = 1; }
static void division(void) { zero = one / zero; }
static void stack(void) { zero = deep(1); }
static void aborted(void) { abort(); }

static void double_free(void) {
    void *volatile piece = malloc(40);
    void *volatile again = piece;
    free(piece);
    free(again);
}

static void fault(void) {
    EXPECT(NO_ERROR, TIMED_WAIT(100 * MS, &code));
    FAULT();
    say("FAILED: it goes on");
}

/* Some of them are not called. */
void (*const all[])(void) = {null_pointer, division, stack, aborted, double_free};

int main(void) {
    begin("fault", fault, 10, 0);
    return normal();
}
