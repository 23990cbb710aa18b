/* The control law and the envelope in C: the same equations in the same order as fffo_drive/control. */
#pragma once

#include <math.h>
#include <stdbool.h>
#include "declarations.h"
#include "friction.h"

static inline int64_t larger_word(int64_t a, int64_t b) { return b > a ? b : a; }

/* ---- PI with friction observer ---- */

static double observer_velocity_rps(const struct observer_config *c, const struct friction_state *state, int64_t toggle,
                                    double reference_rps, double velocity_rps)
{
    if (toggle == TOGGLE_FEEDFORWARD)
        return reference_rps;
    if (fabs(velocity_rps) <= c->feedback_band_rps && velocity_rps * state->direction <= 0.0)
        return 0.0;
    return velocity_rps;
}

static void clamp_estimate(const struct observer_config *c, struct friction_state *state)
{
    state->torque_nm = smaller(larger(state->torque_nm, -c->clamp_nm), c->clamp_nm);
}

/* At rest the contact unloads: the next motion begins with it, in either direction. */
static void release_estimate(struct friction_state *state, double share)
{
    *state = (struct friction_state){(1.0 - share) * state->torque_nm, 0.0, 0.0, 0.0};
}

static void hand_over(const struct controller_config *c, struct controller_state *state, int64_t toggle,
                      const struct reference *reference, double velocity_rps)
{
    if (toggle == TOGGLE_OFF) {
        state->integral_a += state->friction.torque_nm / c->torque_constant_nm_per_a;
        state->friction = (struct friction_state){0.0, 0.0, 0.0, 0.0};
    } else if (state->toggle == TOGGLE_OFF) {
        double driven_rps = observer_velocity_rps(&c->observer, &state->friction, toggle, reference->ahead, velocity_rps);
        state->friction = settled_friction(&c->observer.friction, driven_rps);
        clamp_estimate(&c->observer, &state->friction);
        state->integral_a -= state->friction.torque_nm / c->torque_constant_nm_per_a;
    }
    state->toggle = toggle;
}

/* ---- velocity from position and torque ---- */

static double command_of(const double *commands_a, const struct velocity_estimator_state *state, int64_t tick)
{
    return tick >= state->first_tick ? commands_a[tick & (COMMANDS - 1)] : 0.0;
}

static void hold_skipped(double *commands_a, const struct velocity_estimator_state *state, int64_t tick)
{
    double last_a = command_of(commands_a, state, state->tick), held_a = command_of(commands_a, state, state->tick - 1);
    for (int64_t k = state->tick; k < tick - 1; k++)
        commands_a[k & (COMMANDS - 1)] = held_a;
    commands_a[(tick - 1) & (COMMANDS - 1)] = last_a;
}

static void predict(const struct velocity_estimator_config *c, struct velocity_estimator_state *state,
                    const double *commands_a, const struct measured *measured)
{
    int64_t periods = measured->tick - state->tick;
    double step_s = (double)(measured->woke_ns - state->woke_ns) / 1e9 / (double)periods;
    for (int64_t k = state->tick; k < measured->tick; k++) {
        int64_t newest = k - c->delay_periods;
        double current_a = (1.0 - c->delay_share) * command_of(commands_a, state, newest);
        current_a += c->delay_share * command_of(commands_a, state, newest - 1);
        double torque_nm = c->torque_constant_nm_per_a * current_a - state->disturbance_nm;
        double gained_rps = step_s * torque_nm / c->inertia_nm_s2_per_rev;
        state->position_rev += step_s * (state->velocity_rps + 0.5 * gained_rps);
        state->velocity_rps += gained_rps;
    }
    state->tick = measured->tick;
    state->woke_ns = measured->woke_ns;
}

static void correct(const struct velocity_estimator_config *c, struct velocity_estimator_state *state,
                    double innovation_rev)
{
    state->position_rev += c->position_gain * innovation_rev;
    state->velocity_rps += c->velocity_gain_per_s * innovation_rev;
    state->disturbance_nm -= c->disturbance_gain_nm_per_rev * innovation_rev;
    state->fresh_tick = state->tick;
}

static const struct velocity_estimator_state ESTIMATOR_AT_REST = {0.0, 0.0, 0.0, -1, -1, -1, 0};

static void begin_estimate(struct velocity_estimator_state *state, const struct measured *m)
{
    *state = ESTIMATOR_AT_REST;
    if (m->fresh && isfinite(m->position_rev) && isfinite(m->velocity_rps))
        *state = (struct velocity_estimator_state){m->position_rev, m->velocity_rps, 0.0, m->tick,
                                                   m->tick, m->tick, m->woke_ns};
}

static bool trusted(const struct velocity_estimator_config *c, const struct velocity_estimator_state *state,
                    double drive_rps)
{
    return isfinite(state->position_rev) && isfinite(state->disturbance_nm) &&
           fabs(state->velocity_rps - drive_rps) <= c->disagreement_rps;
}

static struct velocity_estimator_terms velocity_estimator_step(const struct velocity_estimator_config *c,
                                                               struct velocity_estimator_state *state,
                                                               double *commands_a, const struct measured *measured)
{
    struct velocity_estimator_terms terms = {.followed_rps = measured->velocity_rps};
    if (!c->used) {
        *state = ESTIMATOR_AT_REST;
        return terms;
    }
    int64_t without = measured->tick - state->fresh_tick - (measured->fresh ? 1 : 0); /* ticks without feedback */
    if (state->tick < 0 || without > BRIDGED_TICKS) {
        begin_estimate(state, measured);
    } else {
        if (measured->tick - state->tick > 1)
            hold_skipped(commands_a, state, measured->tick);
        predict(c, state, commands_a, measured);
        if (measured->fresh) {
            double innovation_rev = measured->position_rev - state->position_rev;
            if (fabs(innovation_rev) <= c->jump_rev)
                correct(c, state, innovation_rev);
            else
                begin_estimate(state, measured);
        }
        if (state->tick >= 0 && !trusted(c, state, measured->velocity_rps))
            begin_estimate(state, measured);
    }
    if (state->tick < 0)
        return terms;
    terms.estimated = state->tick - state->first_tick >= c->settling_ticks;
    terms.estimated_rps = state->velocity_rps;
    terms.disturbance_nm = state->disturbance_nm;
    if (terms.estimated)
        terms.followed_rps = state->velocity_rps;
    return terms;
}

/* ---- the position hold at rest ---- */

static void hold_step(const struct hold_config *c, struct hold_state *state, double *integral_a, double rest,
                      double position_rev, bool limited, double period_s)
{
    if (!isfinite(position_rev))
        return;
    if (!state->latched) {
        *state = (struct hold_state){rest >= SETTLED, position_rev, 0.0};
        return;
    }
    double away_rev = position_rev - state->position_rev;
    if (fabs(away_rev) > c->travel_rev) {
        away_rev = copysign(c->travel_rev, away_rev);
        state->position_rev = position_rev - away_rev;
    }
    double beyond_rev = larger(fabs(away_rev) - c->dead_band_rev, 0.0);
    if (!limited)
        state->current_a -= c->integral_a_per_rev_s * period_s * copysign(beyond_rev, away_rev);
    double asked_a = state->current_a;
    state->current_a = smaller(larger(asked_a, -c->bound_a), c->bound_a);
    double beyond_a = asked_a - state->current_a;
    if (beyond_a * *integral_a < 0.0)
        *integral_a += copysign(smaller(fabs(beyond_a), fabs(*integral_a)), beyond_a);
}

/* ---- notches on the error ---- */

static double section_step(const struct section_config *c, struct section_state *state, double value)
{
    double passed = c->direct * value + state->first;
    state->first = c->middle * (value - passed) + state->second;
    state->second = c->last * value - c->back * passed;
    return passed;
}

static double notch_step(const struct notch_config *c, struct notch_state *state, double value)
{
    return section_step(&c->second, &state->second, section_step(&c->first, &state->first, value));
}

/* ---- the law ---- */

static void controller_step(const struct controller_config *c, struct controller_state *state, int64_t toggle,
                            const struct reference *reference, double velocity_rps, double added_nm, double followed_rps,
                            double position_rev, struct controller_terms *terms)
{
    if (toggle != state->toggle)
        hand_over(c, state, toggle, reference, velocity_rps);
    double error_rps = reference->expected - followed_rps;
    double driving_rps = c->notches.used ? notch_step(&c->notches, &state->notches, error_rps) : error_rps;
    if (c->error_share < 1.0)
        driving_rps = state->filtered_error_rps + c->error_share * (driving_rps - state->filtered_error_rps);
    state->filtered_error_rps = driving_rps;
    bool at_rest = reference->value == 0.0 && reference->ahead == 0.0;
    state->rest = at_rest ? state->rest + c->rest.fade_share * (1.0 - state->rest) : 0.0;
    double gain_share = 1.0 - state->rest * (1.0 - c->rest.gain_share);
    if (at_rest && c->rest.hold.bound_a > 0.0) {
        hold_step(&c->rest.hold, &state->hold, &state->integral_a, state->rest, position_rev, state->limited,
                  c->period_s);
    } else {
        state->integral_a += state->hold.current_a;
        state->hold = (struct hold_state){0, 0.0, 0.0};
    }
    double hold_a = state->hold.current_a;
    double observation_nm_per_s = 0.0, learned_a_per_rev = 0.0;
    if (toggle != TOGGLE_OFF) {
        if (!(state->limited || at_rest))
            observation_nm_per_s = c->observer.gain_nm_per_rev * driving_rps;
        double into_estimate_nm_per_s = observation_nm_per_s;
        if (c->observer.learns_in_integral) {
            into_estimate_nm_per_s = 0.0;
            if (!at_rest)
                learned_a_per_rev = c->observer.gain_nm_per_rev / c->torque_constant_nm_per_a;
        }
        if (at_rest && c->rest.release_share > 0.0) {
            release_estimate(&state->friction, c->rest.release_share);
        } else {
            double driven_rps =
                observer_velocity_rps(&c->observer, &state->friction, toggle, reference->ahead, velocity_rps);
            friction_step(&c->observer.friction, &state->friction, driven_rps, into_estimate_nm_per_s, c->period_s);
            clamp_estimate(&c->observer, &state->friction);
        }
    }
    double inertia_nm = c->feedforward.inertia_nm_s2_per_rev * reference->ahead_derivative;
    double feedforward_a = (state->friction.torque_nm + inertia_nm + added_nm) / c->torque_constant_nm_per_a;
    double limit_a = c->current_limit_a;
    double proportional_a = gain_share * c->pi.proportional_a_per_rps * driving_rps;
    double integral_a_per_rev = gain_share * c->pi.integral_a_per_rev + learned_a_per_rev;
    double candidate_a = state->integral_a + integral_a_per_rev * driving_rps * c->period_s;
    double sum_a = proportional_a + candidate_a + (hold_a + feedforward_a);
    if (!((fabs(sum_a) > limit_a || state->limited) && driving_rps * sum_a > 0.0))
        state->integral_a = candidate_a;
    double requested_a = proportional_a + state->integral_a + hold_a + feedforward_a;
    double command_a = smaller(larger(requested_a, -limit_a), limit_a);
    state->limited = command_a != requested_a;
    *terms = (struct controller_terms){
        .error_rps = error_rps, .filtered_error_rps = driving_rps, .proportional_a = proportional_a, .integral_a = state->integral_a,
        .hold_a = hold_a,
        .friction_nm = state->friction.torque_nm, .inertia_nm = inertia_nm,
        .observation_nm_per_s = observation_nm_per_s, .requested_a = requested_a, .command_a = command_a,
        .limited = state->limited,
    };
}

/* ---- what is learned in service ---- */

static struct adapted give_adapted(const struct controller_config *c, const struct adaptation_state *learned,
                                   struct controller_state *state, int64_t mode, const struct reference *reference,
                                   int64_t toggle, bool active, double before_nm)
{
    struct adapted given = {0.0, 0.0};
    if (!(c->adaptation.used && active) || mode == MODE_CURRENT)
        return given;
    if (toggle == TOGGLE_FEEDFORWARD) {
        struct friction_state friction = state->friction;
        if (state->toggle == TOGGLE_OFF) {
            friction = settled_friction(&c->observer.friction, reference->ahead);
            clamp_estimate(&c->observer, &friction);
        }
        double velocity_rps = reference->ahead;
        double steady_nm = steady_friction_nm(&c->observer.friction, velocity_rps);
        double viscous_share = c->observer.friction.viscous_nm_per_rps * fabs(velocity_rps) / steady_nm;
        double contact = friction.torque_nm * (1.0 - viscous_share) / c->observer.friction.coulomb_nm;
        double torque_nm = learned->offset_nm + learned->coulomb_nm * contact + learned->viscous_nm_per_rps * velocity_rps;
        given = (struct adapted){contact, torque_nm};
    }
    if (toggle != state->toggle && state->toggle != TOGGLE_NONE)
        state->integral_a += (before_nm - given.torque_nm) / c->torque_constant_nm_per_a;
    return given;
}

static double moved(double value, double way, double bound, double step_share)
{
    double after = value + step_share * smaller(larger(way / FOLLOWS_IN, -bound), bound);
    return smaller(larger(after, -bound), bound);
}

static bool learn(const struct controller_config *config, struct adaptation_state *s, const struct adapted *given,
                  const struct law_output *law, const struct controller_state *state)
{
    const struct adaptation_config *a = &config->adaptation;
    if (!a->used || law->mode != MODE_VELOCITY || state->toggle != TOGGLE_FEEDFORWARD)
        return false;
    bool at_rest = law->reference.value == 0.0 && law->reference.ahead == 0.0;
    double lacking_nm = config->torque_constant_nm_per_a * (law->terms.proportional_a + law->terms.integral_a);
    if (at_rest || state->limited || !isfinite(lacking_nm))
        return false;
    double contact = given->contact, velocity_rps = law->reference.ahead;
    s->weight += a->step_share * (1.0 - s->weight);
    double share = a->step_share / s->weight;
    s->c += share * (contact - s->c);
    s->c2 += share * (contact * contact - s->c2);
    s->w += share * (velocity_rps - s->w);
    s->cw += share * (contact * velocity_rps - s->cw);
    s->w2 += share * (velocity_rps * velocity_rps - s->w2);
    s->r += share * (lacking_nm - s->r);
    s->cr += share * (contact * lacking_nm - s->cr);
    s->wr += share * (velocity_rps * lacking_nm - s->wr);
    double spread = s->c2 - s->c * s->c;
    if (!(spread > EXCITED_SHARE * s->c2))
        return false;
    double at_zero = (s->c2 * s->w - s->c * s->cw) / spread, slope = (s->cw - s->c * s->w) / spread;
    double rest_2 = s->w2 - at_zero * s->w - slope * s->cw;
    double viscous_way = 0.0;
    if (rest_2 > EXCITED_SHARE * s->w2)
        viscous_way = (s->wr - at_zero * s->r - slope * s->cr) / rest_2;
    double offset_way = (s->c2 * s->r - s->c * s->cr) / spread - at_zero * viscous_way;
    double coulomb_way = (s->cr - s->c * s->r) / spread - slope * viscous_way;
    s->offset_nm = moved(s->offset_nm, offset_way, a->torque_bound_nm, a->step_share);
    s->coulomb_nm = moved(s->coulomb_nm, coulomb_way, a->torque_bound_nm, a->step_share);
    s->viscous_nm_per_rps = moved(s->viscous_nm_per_rps, viscous_way, a->viscous_bound_nm_per_rps, a->step_share);
    return true;
}

static int64_t bounds_reached(const struct adaptation_config *a, const struct adaptation_state *s)
{
    if (!a->used)
        return 0;
    int64_t bits = fabs(s->offset_nm) >= a->torque_bound_nm ? OFFSET_AT_BOUND : 0;
    bits |= fabs(s->coulomb_nm) >= a->torque_bound_nm ? COULOMB_AT_BOUND : 0;
    double bound = a->viscous_bound_nm_per_rps;
    return bits | (fabs(s->viscous_nm_per_rps) >= bound && bound > 0.0 ? VISCOUS_AT_BOUND : 0);
}

/* ---- the envelope ---- */

static double i2t_capacity_a2s(const struct envelope_config *c)
{
    double continuous_a2 = c->continuous_current_a * c->continuous_current_a;
    return (c->current_limit_a * c->current_limit_a - continuous_a2) * c->i2t_time_s;
}

static int64_t find_trip(const struct envelope_config *c, const struct envelope_state *state,
                         const struct envelope_inputs *seen)
{
    if (seen->bus_off)
        return TRIP_BUS_OFF;
    if (seen->foreign_frames > 0)
        return TRIP_FOREIGN_COMMAND;
    if (seen->reboots > 0)
        return TRIP_REBOOT;
    if (seen->emergencies > 0)
        return TRIP_EMERGENCY;
    if (seen->statusword & STATUS_FAULT)
        return TRIP_DRIVE_FAULT;
    if (seen->not_operational)
        return TRIP_NOT_OPERATIONAL;
    if (c->heartbeat_timeout_ns > 0 && seen->heartbeat_age_ns > c->heartbeat_timeout_ns)
        return TRIP_HEARTBEAT;
    if (seen->settings_changes > 0)
        return TRIP_SETTINGS_CHANGED;
    if (!seen->wanted)
        return TRIP_NONE;
    if (state->was_enabled && !seen->enabled)
        return TRIP_DRIVE_LEFT;
    if (!(isfinite(seen->requested_a) && isfinite(seen->error_rps)))
        return TRIP_NOT_A_NUMBER;
    if (!(isfinite(seen->velocity_rps) && isfinite(seen->position_rev)))
        return TRIP_NOT_A_NUMBER;
    if (seen->feedback_age >= c->feedback_missing_ticks)
        return TRIP_FEEDBACK_MISSING;
    if (seen->status_age >= c->status_missing_ticks)
        return TRIP_STATUS_MISSING;
    if (state->unheeded_s > UNHEEDED_S)
        return seen->local_control ? TRIP_LOCAL_CONTROL : TRIP_NOT_FOLLOWING;
    if (fabs(seen->velocity_rps) > c->speed_limit_rps)
        return TRIP_OVERSPEED;
    if (!(c->position_low_rev <= seen->position_rev && seen->position_rev <= c->position_high_rev))
        return TRIP_POSITION_WINDOW;
    if (state->reversing_s > c->following_error_s && state->steady_s == 0.0)
        return TRIP_OSCILLATION;
    if (state->following_s > c->following_error_s && state->followed_s == 0.0)
        return TRIP_FOLLOWING_ERROR;
    if (c->i2t_trips && state->i2t_a2s > i2t_capacity_a2s(c))
        return TRIP_I2T;
    return TRIP_NONE;
}

static double clamp_command(const struct envelope_config *c, const struct envelope_state *state, double requested_a,
                            int64_t *limits)
{
    double limit_a = c->current_limit_a;
    if (!c->i2t_trips && state->i2t_a2s > i2t_capacity_a2s(c)) {
        limit_a = c->continuous_current_a;
        if (fabs(requested_a) > limit_a)
            *limits |= LIMIT_I2T;
    }
    double command_a = smaller(larger(requested_a, -limit_a), limit_a);
    if (command_a != requested_a)
        *limits |= LIMIT_CURRENT;
    double step_a = c->slew_a_per_s * c->period_s;
    double slewed_a = smaller(larger(command_a, state->last_command_a - step_a), state->last_command_a + step_a);
    if (slewed_a != command_a)
        *limits |= LIMIT_SLEW;
    return smaller(larger(slewed_a, -c->current_limit_a), c->current_limit_a);
}

static double heat_after(const struct envelope_config *c, double heat_a2s, double current_a, double time_s)
{
    double excess_a2 = current_a * current_a - c->continuous_current_a * c->continuous_current_a;
    return larger(0.0, heat_a2s + excess_a2 * time_s);
}

static void lasting(double *lasts_s, double *pause_s, bool seen, double step_s)
{
    double pause = seen ? 0.0 : *pause_s + step_s;
    bool over = !seen && (*lasts_s == 0.0 || pause >= PAUSE_S);
    *lasts_s = over ? 0.0 : *lasts_s + step_s;
    *pause_s = over ? 0.0 : pause;
}

static void watch_loop(const struct envelope_config *c, struct envelope_state *state,
                       const struct envelope_inputs *seen, double step_s)
{
    bool acts = seen->wanted && seen->closed_loop;
    if (acts) {
        lasting(&state->following_s, &state->followed_s, fabs(seen->error_rps) > c->following_error_rps, step_s);
        bool limited = seen->limited || (seen->statusword & STATUS_INTERNAL_LIMIT);
        double side = 0.0;
        if (limited || !(fabs(seen->requested_a) < c->current_limit_a))
            side = copysign(1.0, seen->requested_a);
        bool reverses = side * state->limited_side < 0.0;
        if (side != 0.0)
            state->limited_side = side;
        lasting(&state->reversing_s, &state->steady_s, reverses, step_s);
    } else {
        state->following_s = state->followed_s = 0.0;
        state->limited_side = state->reversing_s = state->steady_s = 0.0;
    }
    bool unheeded = seen->wanted && (seen->local_control || seen->ignores_target);
    state->unheeded_s = unheeded ? state->unheeded_s + step_s : 0.0;
}

static double envelope_step(const struct envelope_config *c, struct envelope_state *state,
                            const struct envelope_inputs *seen, int64_t *limits, int64_t *trip)
{
    double held_s = (double)seen->skipped_ticks * c->period_s;
    state->i2t_a2s = heat_after(c, state->i2t_a2s, state->last_command_a, held_s);
    watch_loop(c, state, seen, (double)(seen->skipped_ticks + 1) * c->period_s);
    *trip = find_trip(c, state, seen);
    *limits = 0;
    double command_a = 0.0;
    if (*trip == TRIP_NONE && seen->wanted) {
        command_a = clamp_command(c, state, seen->requested_a, limits);
        if (seen->statusword & STATUS_INTERNAL_LIMIT)
            *limits |= LIMIT_DRIVE;
    }
    state->i2t_a2s = heat_after(c, state->i2t_a2s, command_a, c->period_s);
    state->last_command_a = command_a;
    state->was_enabled = seen->wanted && seen->enabled;
    return command_a;
}
