/* The loop of fffo_drive/runtime in C: the same tick on the same memory, for the benchmark of the cycle. */
#define _GNU_SOURCE
#include <string.h>
#include "law.h"
#include "bus.h"

#define FAULT_RESET_TICKS 40

/* ---- CiA 402, seen from the master ---- */

static int64_t state_of(int64_t statusword)
{
    static const int64_t rows[][3] = {
        {STATE_NOT_READY, 0x4F, 0x00}, {STATE_SWITCH_ON_DISABLED, 0x4F, 0x40},
        {STATE_READY_TO_SWITCH_ON, 0x6F, 0x21}, {STATE_SWITCHED_ON, 0x6F, 0x23},
        {STATE_OPERATION_ENABLED, 0x6F, 0x27}, {STATE_QUICK_STOP_ACTIVE, 0x6F, 0x07},
        {STATE_FAULT_REACTION_ACTIVE, 0x4F, 0x0F}, {STATE_FAULT, 0x4F, 0x08},
    };
    for (unsigned i = 0; i < sizeof rows / sizeof rows[0]; i++)
        if ((statusword & rows[i][1]) == rows[i][2])
            return rows[i][0];
    return STATE_UNKNOWN;
}

static bool has_torque(int64_t statusword)
{
    int64_t state = state_of(statusword);
    return state == STATE_UNKNOWN || state == STATE_OPERATION_ENABLED || state == STATE_QUICK_STOP_ACTIVE ||
           state == STATE_FAULT_REACTION_ACTIVE;
}

static int64_t controlword_towards(int64_t statusword, int64_t goal, bool fault_reset, int64_t last)
{
    int64_t state = state_of(statusword);
    if (state == STATE_FAULT) {
        bool edge = last == CONTROL_DISABLE_VOLTAGE || last == CONTROL_FAULT_RESET;
        return fault_reset && edge ? CONTROL_FAULT_RESET : CONTROL_DISABLE_VOLTAGE;
    }
    if (goal == GOAL_QUICK_STOP)
        return CONTROL_QUICK_STOP;
    if (goal == GOAL_READY || goal == GOAL_ENABLED) {
        if (state == STATE_SWITCH_ON_DISABLED)
            return CONTROL_SHUTDOWN;
        if (state == STATE_READY_TO_SWITCH_ON)
            return CONTROL_SWITCH_ON;
        if (state == STATE_SWITCHED_ON || state == STATE_OPERATION_ENABLED)
            return goal == GOAL_ENABLED ? CONTROL_ENABLE_OPERATION : CONTROL_SWITCH_ON;
    }
    return CONTROL_DISABLE_VOLTAGE;
}

/* ---- the drive on the other end, outside the time that is measured ---- */

static int64_t close_part(struct cycle_port *port)
{
    int64_t now_ns = monotonic_ns();
    if (port->words[MARK_NS] > 0)
        port->cycles_ns[port->words[CYCLE]] += now_ns - port->words[MARK_NS];
    return now_ns;
}

static void answer(struct cycle_port *port, int64_t tick)
{
    while (recv((int)port->peer_rx_fd, port->received, FRAME_SIZE, MSG_DONTWAIT) == FRAME_SIZE) {
    }
    send((int)port->peer_tx_fd, port->motion[tick % port->motion_n], FRAME_SIZE, MSG_DONTWAIT);
    if (tick % STATUS_EVERY == 0)
        send((int)port->peer_tx_fd, port->status, FRAME_SIZE, MSG_DONTWAIT);
}

/* Where nothing paces the loop its time is the deadline, so that passes are alike; the clock is read all the same. */
static int64_t loop_now_ns(const struct cycle_port *port)
{
    int64_t now_ns = monotonic_ns();
    return port->paced ? now_ns : port->words[CLOCK_NS];
}

static void begin_cycle(struct cycle_port *port, int64_t deadline_ns)
{
    port->words[CLOCK_NS] = deadline_ns;
    int64_t now_ns = close_part(port);
    if (port->words[MARK_NS] > 0)
        port->words[CYCLE] += 1;
    if (port->paced) {
        sleep_until(deadline_ns);
        now_ns = monotonic_ns();
    }
    port->words[MARK_NS] = now_ns;
}

/* ---- pieces of the tick ---- */

static int64_t take_parameters(struct blocks *blocks, int64_t in_use_number, double *scratch, double *in_use)
{
    int64_t number = load_acquire(&blocks->control[PARAMETER_NUMBER]);
    if (number == in_use_number)
        return in_use_number;
    memcpy(scratch, blocks->parameters[number & 1], sizeof blocks->parameters[0]);
    if (load_acquire(&blocks->control[PARAMETER_NUMBER]) != number) {
        blocks->status[STALE_BLOCKS] += 1;
        return in_use_number;
    }
    memcpy(in_use, scratch, sizeof blocks->parameters[0]);
    return number;
}

static double read_samples(const double *samples, int64_t length, double position)
{
    int64_t below = (int64_t)floor(position);
    double share = position - below;
    double first = 0 <= below && below < length ? samples[below] : 0.0;
    if (share == 0.0)
        return first;
    double second = -1 <= below && below < length - 1 ? samples[below + 1] : 0.0;
    return first + share * (second - first);
}

static struct reference follow_profile(struct blocks *blocks, struct profile_cursor *cursor,
                                       const struct feedforward_config *feedforward, int64_t tick, bool active,
                                       int64_t tail_ticks, int64_t *sample_out)
{
    const struct reference nothing = {0.0, 0.0, 0.0, 0.0, 0.0};
    *sample_out = -1;
    int64_t number = load_acquire(&blocks->control[PROFILE_NUMBER]);
    if (number != cursor->number && active) {
        const int64_t *words = blocks->profile_words[number & 1];
        *cursor = (struct profile_cursor){number, tick, words[0], words[1]};
    }
    if (cursor->start_tick < 0)
        return nothing;
    int64_t sample = tick - cursor->start_tick;
    bool aborted = load_acquire(&blocks->control[PROFILE_ABORT]) == cursor->number;
    if (sample >= cursor->length + tail_ticks || aborted || !active) {
        blocks->status[PROFILE_DONE] = cursor->number;
        *cursor = (struct profile_cursor){cursor->number, -1, 0, MODE_IDLE};
        return nothing;
    }
    *sample_out = sample;
    const double *values = blocks->profiles[cursor->number & 1][0];
    const double *derivatives = blocks->profiles[cursor->number & 1][1];
    int64_t past = blocks->profile_words[cursor->number & 1][2];
    int64_t length = past + cursor->length;
    double now = past + sample, ahead = now + feedforward->ahead_ticks;
    return (struct reference){
        .value = read_samples(values, length, now),
        .derivative = read_samples(derivatives, length, now),
        .ahead = read_samples(values, length, ahead),
        .ahead_derivative = read_samples(derivatives, length, ahead),
        .expected = read_samples(values, length, now - feedforward->behind_ticks),
    };
}

static struct velocity_estimator_terms estimate_velocity(const struct controller_config *config,
                                                         struct velocity_estimator_state *state, struct blocks *blocks,
                                                         int64_t mode, const struct timing *timing,
                                                         const struct feedback *feedback, bool active)
{
    if (!active || mode == MODE_CURRENT) {
        *state = ESTIMATOR_AT_REST;
        return (struct velocity_estimator_terms){.followed_rps = feedback->velocity_rps};
    }
    struct measured measured = {timing->tick, timing->woke_ns, feedback->velocity_tick == timing->tick,
                                feedback->position_rev, feedback->velocity_rps};
    return velocity_estimator_step(&config->velocity, state, blocks->commands, &measured);
}

static struct law_output apply_law(const struct controller_config *config, struct controller_state *state, int64_t mode,
                            const struct reference *reference, double velocity_rps, int64_t toggle, bool active,
                            double added_nm, double followed_rps, double position_rev)
{
    struct law_output law = {.mode = MODE_IDLE};
    if (!active || mode == MODE_CURRENT) {
        if (active) {
            law.mode = MODE_CURRENT;
            law.terms.requested_a = law.terms.command_a = reference->value;
        }
        *state = (struct controller_state){.toggle = TOGGLE_NONE};
        return law;
    }
    law.mode = MODE_VELOCITY;
    law.reference = *reference;
    controller_step(config, state, toggle, reference, velocity_rps, added_nm, followed_rps, position_rev, &law.terms);
    return law;
}

static bool in_local_control(int64_t served_bits, int64_t statusword)
{
    return served_bits & ~statusword & STATUS_REMOTE && !(statusword & STATUS_FAULT) && statusword & NOT_READY_MASK;
}

static struct envelope_inputs look(const struct feedback *feedback, const struct loop_config *config,
                                   const struct timing *timing,
                                   const struct baseline *baseline, const struct law_output *law, bool wanted, bool enabled,
                                   int64_t skipped_ticks)
{
    return (struct envelope_inputs){
        .requested_a = law->terms.command_a,
        .velocity_rps = feedback->velocity_rps,
        .position_rev = feedback->position_rev,
        .error_rps = law->mode == MODE_VELOCITY ? law->reference.expected - feedback->velocity_rps : 0.0,
        .feedback_age = timing->tick - feedback->velocity_tick,
        .status_age = timing->tick - feedback->status_tick,
        .statusword = feedback->statusword,
        .emergencies = feedback->emergency_count - baseline->emergencies,
        .reboots = feedback->boot_count - baseline->boots,
        .not_operational = (feedback->nmt_state >= 0 && feedback->nmt_state != NMT_OPERATIONAL) ||
                           feedback->nmt_exits != baseline->nmt_exits,
        .bus_off = feedback->bus_off != 0 || feedback->bus_losses != baseline->bus_losses,
        .foreign_frames = feedback->foreign_frames - baseline->foreign_frames,
        .settings_changes = feedback->settings_changed - baseline->settings_changes,
        .heartbeat_age_ns = feedback->heartbeat_ns >= 0 ? timing->woke_ns - feedback->heartbeat_ns : -1,
        .wanted = wanted,
        .enabled = enabled,
        .closed_loop = law->mode == MODE_VELOCITY,
        .local_control = in_local_control(config->served_status_bits, feedback->statusword),
        .ignores_target = law->mode != MODE_IDLE && config->served_status_bits & STATUS_FOLLOWS_COMMAND &&
                          !(feedback->statusword & (STATUS_FOLLOWS_COMMAND | STATUS_INTERNAL_LIMIT)),
        .skipped_ticks = skipped_ticks,
        .limited = law->terms.limited,
    };
}

static int64_t flags_of(const struct envelope_inputs *seen, bool loop_began, bool estimated, bool adapts)
{
    int64_t flags = loop_began ? FLAG_LOOP_BEGAN : 0;
    flags |= estimated ? FLAG_ESTIMATED_VELOCITY : 0;
    flags |= adapts ? FLAG_ADAPTS : 0;
    flags |= seen->emergencies > 0 ? FLAG_EMERGENCY : 0;
    flags |= seen->reboots > 0 ? FLAG_REBOOT : 0;
    flags |= seen->not_operational ? FLAG_NOT_OPERATIONAL : 0;
    flags |= seen->bus_off ? FLAG_BUS_OFF : 0;
    flags |= seen->local_control ? FLAG_LOCAL_CONTROL : 0;
    flags |= seen->ignores_target ? FLAG_IGNORES_TARGET : 0;
    flags |= seen->settings_changes > 0 ? FLAG_SETTINGS_CHANGED : 0;
    return flags | (seen->foreign_frames > 0 ? FLAG_FOREIGN_COMMAND : 0);
}

static void write_row(struct row *row, int64_t head, const struct timing *timing, const struct loop_config *config,
                      const struct law_output *law, const struct adapted *given, const struct adaptation_state *learned,
                      const struct velocity_estimator_terms *estimate,
                      const struct envelope_inputs *seen, const struct feedback *feedback)
{
    int64_t lateness_ns = timing->woke_ns - timing->deadline_ns;
    row->tick = timing->tick;
    row->row_number = (uint32_t)head;
    row->deadline_ns = timing->deadline_ns;
    row->lateness_ns = lateness_ns;
    row->turnaround_ns = timing->turnaround_ns;
    row->late = lateness_ns > config->late_ns;
    row->estimated_rps = estimate->estimated_rps;
    row->disturbance_nm = estimate->disturbance_nm;
    row->effects = 0; /* a loop without effects */
    row->effects_nm = 0.0;
    row->adapted_nm = given->torque_nm;
    row->adapted_offset_nm = learned->offset_nm;
    row->adapted_coulomb_nm = learned->coulomb_nm;
    row->adapted_viscous_nm_per_rps = learned->viscous_nm_per_rps;
    row->reference_rps = law->reference.value;
    row->reference_rps2 = law->reference.derivative;
    row->reference_ahead_rps = law->reference.ahead;
    row->reference_ahead_rps2 = law->reference.ahead_derivative;
    row->expected_rps = law->reference.expected;
    row->mode = law->mode;
    row->error_rps = law->terms.error_rps;
    row->filtered_error_rps = law->terms.filtered_error_rps;
    row->proportional_a = law->terms.proportional_a;
    row->integral_a = law->terms.integral_a;
    row->hold_a = law->terms.hold_a;
    row->friction_nm = law->terms.friction_nm;
    row->inertia_nm = law->terms.inertia_nm;
    row->observation_nm_per_s = law->terms.observation_nm_per_s;
    row->requested_a = law->terms.requested_a;
    row->velocity_rps = seen->velocity_rps;
    row->position_rev = seen->position_rev;
    row->velocity_age = seen->feedback_age;
    row->status_age = seen->status_age;
    row->heartbeat_age_ns = seen->heartbeat_age_ns;
    row->statusword = seen->statusword;
    row->current_a = feedback->current_a;
    row->foreign_id = feedback->foreign_id;
    row->true_velocity_rps = feedback->true_velocity_rps;
    row->true_friction_nm = feedback->true_friction_nm;
}

static int64_t goal_in_force(const struct envelope_config *config, int64_t trip, int64_t goal,
                             const struct envelope_inputs *seen)
{
    if (trip == TRIP_NONE)
        return goal == GOAL_ENABLED && seen->local_control && !seen->enabled ? GOAL_DISABLED : goal;
    return config->reactions[trip] == REACTION_QUICK_STOP ? GOAL_QUICK_STOP : GOAL_DISABLED;
}

int64_t run_loop(struct cycle_port *cycle, const struct loop_config *config, const struct envelope_config *envelope_config,
                 struct blocks *blocks, double *scratch, struct ring *ring, int64_t first_deadline_ns)
{
    struct canopen_port *port = &cycle->canopen;
    struct feedback *feedback = port->feedback;
    int64_t *control = blocks->control, *status = blocks->status;
    double *in_use = scratch + sizeof blocks->parameters[0] / sizeof(double);
    int64_t parameter_number = take_parameters(blocks, -1, scratch, in_use);
    status[PARAMETERS_IN_USE] = parameter_number;
    struct controller_config controller_config;
    unpack_controller(in_use, &controller_config);
    struct controller_state controller = {.toggle = TOGGLE_NONE};
    struct velocity_estimator_state estimator = ESTIMATOR_AT_REST;
    struct adaptation_state learned = {0};
    struct adapted given = {0};
    struct envelope_state envelope = {.was_enabled = 0};
    struct profile_cursor cursor = {status[PROFILE_DONE], -1, 0, MODE_IDLE};
    struct baseline baseline = {feedback->emergency_count, feedback->boot_count, feedback->bus_losses,
                                feedback->nmt_exits, feedback->foreign_frames, feedback->settings_changed};
    int64_t reset_number = load_acquire(&control[RESET_NUMBER]), reset_ticks = 0;
    int64_t trip = TRIP_NONE, controlword = 0, stopping_ticks = 0, head = load_acquire(&ring->words[HEAD]);
    int64_t last_sync_ns = first_deadline_ns - config->period_ns, deadline_ns = first_deadline_ns;
    int64_t tick = 0, ticks_run = 0, enabled_ticks = 0;

    for (;;) {
        begin_cycle(cycle, larger_word(deadline_ns, last_sync_ns + config->minimum_gap_ns));
        int64_t woke_ns = loop_now_ns(cycle);
        int64_t missed = woke_ns > deadline_ns ? (woke_ns - deadline_ns) / config->period_ns : 0;
        status[SKIPPED_TICKS] += missed;
        struct timing timing = {tick + missed, deadline_ns + missed * config->period_ns, woke_ns, -1};
        last_sync_ns = woke_ns;

        bus_sync(port, timing.tick);
        close_part(cycle);
        answer(cycle, timing.tick);
        cycle->words[MARK_NS] = monotonic_ns();
        int64_t sync_ns = loop_now_ns(cycle);
        if (bus_receive(port, timing.tick, sync_ns + config->cutoff_ns))
            timing.turnaround_ns = feedback->received_ns - sync_ns;
        else
            status[MISSING_FEEDBACK] += 1;
        if (timing.woke_ns - timing.deadline_ns > config->late_ns)
            status[LATE_TICKS] += 1;

        int64_t request_number = load_acquire(&control[REQUEST_NUMBER]);
        int64_t number = take_parameters(blocks, parameter_number, scratch, in_use);
        if (number != parameter_number) {
            parameter_number = status[PARAMETERS_IN_USE] = number;
            unpack_controller(in_use, &controller_config);
        }
        number = load_acquire(&control[RESET_NUMBER]);
        if (number != reset_number) {
            reset_number = number;
            reset_ticks = FAULT_RESET_TICKS;
            trip = TRIP_NONE;
            envelope = (struct envelope_state){.i2t_a2s = envelope.i2t_a2s};
            baseline = (struct baseline){feedback->emergency_count, feedback->boot_count, feedback->bus_losses,
                                feedback->nmt_exits, feedback->foreign_frames, feedback->settings_changed};
        }
        int64_t toggle = load_acquire(&control[TOGGLE]), goal = load_acquire(&control[GOAL]);
        if (stopping_ticks > 0)
            goal = GOAL_DISABLED;

        bool enabled = state_of(feedback->statusword) == STATE_OPERATION_ENABLED;
        enabled_ticks = enabled ? enabled_ticks + timing.tick - tick + 1 : 0;
        bool wanted = goal == GOAL_ENABLED && trip == TRIP_NONE && reset_ticks == 0;
        bool active = wanted && enabled_ticks > config->enable_delay_ticks;
        bool was_running = cursor.start_tick >= 0;
        int64_t sample;
        struct reference reference = follow_profile(blocks, &cursor, &controller_config.feedforward, timing.tick,
                                                    active, config->tail_ticks, &sample);
        if (was_running && cursor.start_tick < 0 && load_acquire(&control[AUTOSTOP]) != 0) {
            stopping_ticks = 1;
            goal = GOAL_DISABLED;
            wanted = active = false;
        }
        struct velocity_estimator_terms estimate = estimate_velocity(&controller_config, &estimator, blocks,
                                                                     cursor.mode, &timing, feedback, active);
        given = give_adapted(&controller_config, &learned, &controller, cursor.mode, &reference, toggle, active,
                             given.torque_nm);
        struct law_output law = apply_law(&controller_config, &controller, cursor.mode, &reference, feedback->velocity_rps,
                                   toggle, active, given.torque_nm, estimate.followed_rps,
                                   feedback->position_rev);

        struct envelope_inputs seen = look(feedback, config, &timing, &baseline, &law, wanted, enabled,
                                           timing.tick - tick);
        int64_t limits, found;
        double command_a = envelope_step(envelope_config, &envelope, &seen, &limits, &found);
        if (limits != 0)
            controller.limited = 1;
        if (law.terms.limited)
            limits |= LIMIT_CONTROLLER;
        if (found != TRIP_NONE && trip == TRIP_NONE && reset_ticks == 0) {
            trip = found;
            status[TRIP_TICK] = timing.tick;
            status[TRIP_STATUSWORD] = seen.statusword;
        }
        if (trip != TRIP_NONE)
            command_a = 0.0;

        int64_t goal_now = goal_in_force(envelope_config, trip, goal, &seen);
        controlword = controlword_towards(seen.statusword, goal_now, reset_ticks > 0, controlword);
        double current_a = bus_command(port, controlword, command_a);
        int64_t busy_ns = loop_now_ns(cycle) - timing.woke_ns;
        blocks->commands[timing.tick & (COMMANDS - 1)] = current_a;

        struct row *row = &ring->rows[head & (ring->rows_n - 1)];
        write_row(row, head, &timing, config, &law, &given, &learned, &estimate, &seen, feedback);
        bool adapts = learn(&controller_config, &learned, &given, &law, &controller);
        status[ADAPTED_TO_BOUND] = bounds_reached(&controller_config.adaptation, &learned);
        row->limited_a = command_a;
        row->current_command_a = current_a;
        row->busy_ns = busy_ns;
        row->controlword = controlword;
        row->limits = limits;
        row->trip = trip;
        row->profile_sample = sample;
        row->toggle = toggle;
        row->i2t_a2s = envelope.i2t_a2s;
        row->request_number = request_number;
        row->parameters_number = parameter_number;
        row->effects_number = load_acquire(&control[EFFECTS_NUMBER]);
        row->profile_number = cursor.number;
        row->set_point_number = status[SET_POINT_DONE]; /* a loop without live set points */
        row->set_point_sample = -1;
        row->set_point_rps = 0.0;
        row->flags = flags_of(&seen, ticks_run == 0, estimate.estimated, adapts);
        row->goal = goal;
        row->resetting = reset_ticks;
        head += 1;
        store_release(&ring->words[HEAD], head);
        status[DEADLINE_NS] = timing.deadline_ns;
        status[MODE] = row->mode;
        status[TRIP] = row->trip;
        status[STATUSWORD] = row->statusword;
        status[PROFILE_SAMPLE] = row->profile_sample;
        store_release(&status[TICK], timing.tick);
        bus_housekeeping(port, timing.tick, trip != TRIP_NONE);

        if (reset_ticks > 0)
            reset_ticks -= 1;
        ticks_run += 1;
        if (stopping_ticks > 0) {
            stopping_ticks += 1;
            if (!has_torque(seen.statusword) || stopping_ticks > config->stop_ticks)
                break;
        }
        if (load_acquire(&control[STOP]) != 0)
            break;
        if (config->max_ticks > 0 && ticks_run >= config->max_ticks)
            break;
        tick = timing.tick + 1;
        deadline_ns = timing.deadline_ns + config->period_ns;
    }
    bus_command(port, 0, 0.0);
    store_release(&status[FINISHED], 1);
    return ticks_run;
}
