/* The cyclic exchange with a CANopen drive in C: the calls and rules of fffo_drive/drive/canopen. */
#pragma once

#include <errno.h>
#include <math.h>
#include <poll.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <sys/socket.h>
#include <time.h>
#include "declarations.h"

#define MAX_DRAINED (1 << 14)
#define FLOOD_CHECK 32
#define NS_PER_S 1000000000LL

static int64_t state_of(int64_t statusword); /* loop.c */

static inline int64_t load_acquire(const int64_t *word)
{
    return atomic_load_explicit((const _Atomic int64_t *)word, memory_order_acquire);
}

static inline void store_release(int64_t *word, int64_t value)
{
    atomic_store_explicit((_Atomic int64_t *)word, value, memory_order_release);
}

static inline int64_t monotonic_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * NS_PER_S + now.tv_nsec;
}

static inline void sleep_until(int64_t deadline_ns)
{
    struct timespec deadline = {deadline_ns / NS_PER_S, deadline_ns % NS_PER_S};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &deadline, NULL) == EINTR) {
    }
}

static inline bool wait_readable(int64_t fd, int64_t timeout_ns)
{
    struct pollfd wanted = {(int)fd, POLLIN, 0};
    struct timespec timeout = {timeout_ns / NS_PER_S, timeout_ns % NS_PER_S};
    return ppoll(&wanted, 1, &timeout, NULL) != 0;
}

/* ---- sending ---- */

static void note_bus_state(struct canopen_port *port)
{
    int64_t off = port->memory[CONTROLLER_OFF] != 0 || port->memory[INTERFACE_OFF] != 0;
    if (off > port->feedback->bus_off)
        port->feedback->bus_losses += 1;
    port->feedback->bus_off = off;
}

static void note_errno(struct canopen_port *port, int error)
{
    if (error == ENETDOWN || error == ENODEV || error == ENXIO)
        port->memory[INTERFACE_OFF] = 1;
    note_bus_state(port);
}

static bool send_frame(struct canopen_port *port, const void *frame)
{
    port->memory[SEND_ATTEMPTS] += 1;
    if (send((int)port->tx_fd, frame, FRAME_SIZE, MSG_DONTWAIT) == FRAME_SIZE) {
        if (port->memory[INTERFACE_OFF] != 0) {
            port->memory[INTERFACE_OFF] = 0;
            note_bus_state(port);
        }
        return true;
    }
    port->feedback->send_errors += 1;
    note_errno(port, errno);
    return false;
}

/* ---- receiving ---- */

static bool read_frame(struct canopen_port *port)
{
    for (;;) {
        ssize_t n = recv((int)port->rx_fd, port->received, FRAME_SIZE, MSG_DONTWAIT);
        if (n == FRAME_SIZE)
            return true;
        if (n >= 0) {
            port->feedback->bad_frames += 1;
        } else if (errno == EAGAIN) {
            return false;
        } else if (errno != EINTR) {
            note_errno(port, errno);
            return false;
        }
    }
}

static int64_t unwrap(int64_t *memory, int64_t raw)
{
    if (memory[POSITION_KNOWN] == 0) {
        memory[POSITION_KNOWN] = 1;
        memory[POSITION_COUNTS] = raw;
    } else {
        memory[POSITION_COUNTS] += ((raw - memory[POSITION_RAW] + 0x80000000LL) & 0xFFFFFFFFLL) - 0x80000000LL;
    }
    memory[POSITION_RAW] = raw;
    return memory[POSITION_COUNTS];
}

static void decode(struct canopen_port *port, int64_t slot, int64_t tick)
{
    struct feedback *feedback = port->feedback;
    for (int64_t row = 0; row < port->fields_n; row++) {
        const int64_t *field = port->fields[row];
        if (field[0] != slot)
            continue;
        int64_t size = field[2], raw = 0;
        for (int64_t i = 0; i < size; i++)
            raw |= (int64_t)port->received[DATA_OFFSET + field[1] + i] << (8 * i);
        if (field[3] != 0 && raw >= 1LL << (8 * size - 1))
            raw -= 1LL << (8 * size);
        switch (field[4]) {
        case FIELD_VELOCITY:
            feedback->velocity_rps = raw * port->scaling.velocity_rps_per_unit;
            feedback->velocity_tick = tick;
            break;
        case FIELD_POSITION:
            feedback->position_rev = unwrap(port->memory, raw) * port->scaling.position_rev_per_count;
            break;
        case FIELD_TORQUE:
            feedback->current_a = raw / port->scaling.feedback_units_per_a;
            break;
        case FIELD_STATUSWORD:
            feedback->statusword = raw;
            feedback->status_tick = tick;
            break;
        }
    }
}

static void note_foreign(struct canopen_port *port, int64_t can_id, int64_t count)
{
    if (port->feedback->foreign_frames == 0)
        port->feedback->foreign_id = can_id;
    port->feedback->foreign_frames += count;
}

static void take_second_answer(struct canopen_port *port, int64_t can_id)
{
    port->feedback->duplicate_feedback += 1;
    port->memory[SECOND_ANSWERS] += SECOND_EVERY;
    note_foreign(port, can_id, port->memory[SECOND_ANSWERS] > SECOND_EVERY * SECOND_BURST);
}

static void take_masters_frame(struct canopen_port *port, int64_t word, int64_t kind)
{
    if (kind == OF_SERVICE && port->memory[HEARD_ASIDE] < load_acquire(&port->queue.words[SENT_ASIDE]))
        port->memory[HEARD_ASIDE] += 1;
    else
        note_foreign(port, word & STANDARD_MASK, 1);
}

static void take_answer(struct canopen_port *port, int64_t slot, int64_t tick, bool in_time)
{
    int64_t *memory = port->memory, bit = 1LL << slot;
    if (memory[ANSWERED] & bit) {
        memory[ANSWERED_TWICE] |= bit;
        if (memory[OWED] == 0)
            take_second_answer(port, port->known[slot][0]);
    }
    if (!in_time || (memory[ANSWERED_TWICE] & bit))
        port->feedback->late_feedback += 1;
    memory[ANSWERED] |= bit;
    memory[OWED] = memory[OWED] > 0 ? memory[OWED] - 1 : 0;
    if (in_time) {
        decode(port, slot, tick);
        port->feedback->received_ns = monotonic_ns();
    }
}

static void take_node_message(struct canopen_port *port, int64_t can_id, int64_t length)
{
    struct feedback *feedback = port->feedback;
    const uint8_t *data = port->received + DATA_OFFSET;
    if (can_id == EMERGENCY + port->node_id) {
        if (length < 2) {
            feedback->bad_frames += 1;
            return;
        }
        int64_t code = data[0] | data[1] << 8;
        for (int64_t i = MEMORY_WORDS; i < port->memory_n; i++)
            if (port->memory[i] == code) {
                feedback->warning_code = code;
                feedback->warning_count += 1;
                return;
            }
        feedback->emergency_code = code;
        feedback->emergency_count += code != 0;
    } else if (length != 1) {
        feedback->bad_frames += 1;
    } else {
        int64_t before = feedback->nmt_state, state = data[0] & 0x7F;
        feedback->boot_count += state == 0;
        feedback->nmt_exits += state != 0 && state != NMT_OPERATIONAL && before == NMT_OPERATIONAL;
        feedback->nmt_state = state;
        feedback->heartbeat_ns = monotonic_ns();
    }
}

static void take_frame(struct canopen_port *port, int64_t tick, bool in_time)
{
    int64_t word = port->received_words[0];
    if (word & ERROR_FLAG) {
        port->feedback->error_frames += 1;
        if (word & ERROR_BUS_OFF)
            port->memory[CONTROLLER_OFF] = 1;
        if (word & ERROR_RESTARTED)
            port->memory[CONTROLLER_OFF] = 0;
        note_bus_state(port);
        return;
    }
    if (port->memory[CONTROLLER_OFF] != 0) {
        port->memory[CONTROLLER_OFF] = 0;
        note_bus_state(port);
    }
    int64_t can_id = word & EXTENDED_MASK, slot = -1;
    for (int64_t i = 0; i < port->known_n; i++)
        if (port->known[i][0] == can_id || port->known[i][0] == word) {
            slot = i;
            break;
        }
    int64_t kind = slot >= 0 ? port->known[slot][2] : -1;
    if (kind >= OF_LOOP) {
        if (word == port->known[slot][0])
            take_masters_frame(port, word, kind);
        return;
    }
    if (slot < 0 && can_id != EMERGENCY + port->node_id && can_id != HEARTBEAT + port->node_id)
        return;
    int64_t length = port->received[LENGTH_OFFSET];
    if ((word & (EXTENDED_FLAG | REMOTE_FLAG)) || length > MAX_DATA || (slot >= 0 && length != port->known[slot][1]))
        port->feedback->bad_frames += 1;
    else if (slot < 0)
        take_node_message(port, can_id, length);
    else if (kind == ANSWERS_SYNC)
        take_answer(port, slot, tick, in_time);
    else
        decode(port, slot, tick);
}

/* ---- the exchange ---- */

static void bus_sync(struct canopen_port *port, int64_t tick)
{
    int64_t *memory = port->memory;
    for (int drained = 0; drained < MAX_DRAINED && read_frame(port); drained++)
        take_frame(port, tick - 1, false);
    memory[AMBIGUOUS] = (memory[ANSWERED] & memory[EXPECTED]) != memory[EXPECTED];
    memory[IN_TIME_TICKS] = memory[AMBIGUOUS] == 0 ? memory[IN_TIME_TICKS] + 1 : 0;
    if (memory[IN_TIME_TICKS] > LOST_TICKS)
        memory[OWED] = 0;
    memory[ANSWERED] = memory[ANSWERED_TWICE] = memory[EXPECTED] = 0;
    memory[SECOND_ANSWERS] = memory[SECOND_ANSWERS] > 0 ? memory[SECOND_ANSWERS] - 1 : 0;
    if (memory[CONTROLLER_OFF] == 0 && send_frame(port, port->frames[SYNC_FRAME])) {
        memory[EXPECTED] = port->answer_mask;
        memory[OWED] += memory[ANSWERS];
    }
}

static bool bus_receive(struct canopen_port *port, int64_t tick, int64_t cutoff_ns)
{
    int64_t *memory = port->memory, mask = port->answer_mask;
    for (;;) {
        int64_t left_ns = cutoff_ns - monotonic_ns();
        if (left_ns <= 0 || !wait_readable(port->rx_fd, left_ns))
            left_ns = 0;
        for (int count = 0; count < FLOOD_CHECK && read_frame(port); count++)
            take_frame(port, tick, true);
        if (memory[ANSWERED] == mask && (memory[AMBIGUOUS] == 0 || memory[ANSWERED_TWICE] == mask))
            break;
        if (left_ns == 0)
            break;
    }
    return memory[ANSWERED] == mask;
}

static double bus_command(struct canopen_port *port, int64_t controlword, double current_a)
{
    if (port->feedback->bus_off)
        return 0.0;
    int64_t target = 0;
    if (current_a == current_a) {
        double limit = (double)((1LL << (8 * port->target_bytes - 1)) - 1);
        double limited = current_a * port->scaling.target_units_per_a;
        limited = limited < -limit ? -limit : limited > limit ? limit : limited;
        target = (int64_t)floor(limited + 0.5);
    }
    uint8_t *frame = port->frames[COMMAND_FRAME];
    frame[port->controlword_at] = controlword & 0xFF;
    frame[port->controlword_at + 1] = (controlword >> 8) & 0xFF;
    for (int64_t i = 0; i < port->target_bytes; i++)
        frame[port->target_at + i] = (target >> (8 * i)) & 0xFF;
    if (!send_frame(port, frame) || target == 0)
        return 0.0;
    return target / port->scaling.target_units_per_a;
}

static int64_t next_service_frame(struct queue_memory *queue, int64_t now_ns)
{
    store_release(&queue->words[CYCLE_NS], now_ns);
    int64_t head = load_acquire(&queue->words[HEAD]), tail = queue->words[TAIL];
    while (tail < head && now_ns - queue->times[tail % SLOTS] > MAX_AGE_NS)
        tail += 1;
    store_release(&queue->words[TAIL], tail);
    return tail < head ? tail % SLOTS : -1;
}

static bool withdraw(struct canopen_port *port, int64_t tick)
{
    static const int64_t withdrawal[] = {ZERO_TARGET, SAME_CONTROLWORD, BE_PRE_OPERATIONAL, ZERO_TARGET,
                                         SAME_CONTROLWORD};
    int64_t turn = port->memory[TRIPPED_TICKS]++, state = port->feedback->nmt_state;
    bool silent = tick - port->feedback->velocity_tick > SILENT_TICKS || (state >= 0 && state != NMT_OPERATIONAL);
    int64_t step = turn % WITHDRAWAL_EVERY;
    bool says_so_since = port->feedback->status_tick > tick - turn + BESIDE_RPDO;
    if (turn >= WITHDRAWAL_EVERY && says_so_since && state_of(port->feedback->statusword) == STATE_OPERATION_ENABLED)
        port->memory[DISOBEYS] = 1;
    if (step >= (int64_t)(sizeof withdrawal / sizeof *withdrawal) ||
        (turn >= BESIDE_RPDO && !silent && port->memory[DISOBEYS] == 0))
        return false;
    int64_t chosen = withdrawal[step], *words = port->queue.words;
    uint8_t *frame = port->frames[chosen];
    if (chosen == SAME_CONTROLWORD) {
        frame[SDO_DATA] = port->frames[COMMAND_FRAME][port->controlword_at];
        frame[SDO_DATA + 1] = port->frames[COMMAND_FRAME][port->controlword_at + 1];
    }
    if (chosen != BE_PRE_OPERATIONAL)
        store_release(&words[LOOP_REQUESTS], load_acquire(&words[LOOP_REQUESTS]) + 1);
    send_frame(port, frame);
    return true;
}

static void bus_housekeeping(struct canopen_port *port, int64_t tick, bool tripped)
{
    struct queue_memory *queue = &port->queue;
    int64_t now_ns = monotonic_ns(), slot = next_service_frame(queue, now_ns);
    if (port->feedback->bus_off) {
        store_release(&queue->words[TAIL], load_acquire(&queue->words[HEAD]));
        return;
    }
    if (!tripped)
        port->memory[TRIPPED_TICKS] = port->memory[DISOBEYS] = 0;
    else if (withdraw(port, tick))
        return;
    if (now_ns >= port->memory[NEXT_HEARTBEAT_NS]) {
        if (send_frame(port, port->frames[HEARTBEAT_FRAME]))
            port->memory[NEXT_HEARTBEAT_NS] = now_ns + port->heartbeat_period_ns;
    } else if (slot >= 0 && send_frame(port, queue->frames[slot])) {
        store_release(&queue->words[TAIL], queue->words[TAIL] + 1);
    }
}
