/* The 2SEP friction in C: the same equations in the same order as fffo_drive/model/friction. */
#pragma once

#include <math.h>
#include <stdbool.h>
#include "declarations.h"

static inline double larger(double a, double b) { return b > a ? b : a; }
static inline double smaller(double a, double b) { return b < a ? b : a; }

static double steady_friction_nm(const struct friction_config *c, double velocity_rps)
{
    double speed = fabs(velocity_rps);
    double ratio = speed / c->stribeck_velocity_rps;
    double stribeck;
    if (ratio > STRIBECK_FLOOR)
        stribeck = exp(-pow(ratio, c->stribeck_exponent));
    else
        stribeck = c->stribeck_exponent > 0.0 ? 1.0 : 0.0;
    double excess_nm = c->static_nm - c->coulomb_nm;
    return c->coulomb_nm + excess_nm * stribeck + c->viscous_nm_per_rps * speed;
}

static double hysteresis_amplitude_nm(const struct friction_config *c, double torque_nm, double direction)
{
    double distance_nm = c->coulomb_nm - direction * torque_nm;
    if (c->omega_form == OMEGA_CLIPPED)
        distance_nm = larger(0.0, distance_nm);
    else if (c->omega_form == OMEGA_LITERAL)
        distance_nm = fabs(distance_nm);
    return direction * distance_nm;
}

static double mean_decay(double exponent)
{
    return exponent < 1e-12 ? 1.0 : -expm1(-exponent) / exponent;
}

static void friction_step(const struct friction_config *c, struct friction_state *state, double velocity_rps,
                          double observation_nm_per_s, double period_s)
{
    double sign = velocity_rps > 0.0 ? 1.0 : velocity_rps < 0.0 ? -1.0 : 0.0;
    double speed_rps = fabs(velocity_rps);
    if (sign != state->direction && sign != 0.0) {
        state->omega_nm = hysteresis_amplitude_nm(c, state->torque_nm, sign);
        state->travel_rev = 0.0;
        state->direction = sign;
    }
    double distance_rev = speed_rps * period_s;
    double steady_nm = steady_friction_nm(c, speed_rps);
    double lag_per_rev = c->attraction_nm_per_rev / steady_nm;
    double stiffness_per_rev = c->stiffness_per_rev;

    double torque_nm = state->torque_nm;
    torque_nm += (state->direction * steady_nm - torque_nm) * -expm1(-lag_per_rev * distance_rev);
    if (stiffness_per_rev * state->travel_rev <= PRESLIDING_OVER) {
        double slower_per_rev = smaller(lag_per_rev, stiffness_per_rev);
        double gap_per_rev = fabs(lag_per_rev - stiffness_per_rev);
        double overlap_rev = distance_rev * exp(-slower_per_rev * distance_rev) * mean_decay(gap_per_rev * distance_rev);
        torque_nm += state->omega_nm * stiffness_per_rev * exp(-stiffness_per_rev * state->travel_rev) * overlap_rev;
    }
    if (observation_nm_per_s != 0.0)
        torque_nm += observation_nm_per_s * period_s * mean_decay(lag_per_rev * distance_rev);
    state->torque_nm = torque_nm;
    state->travel_rev += distance_rev;
}

static inline struct friction_state settled_friction(const struct friction_config *c, double velocity_rps)
{
    struct friction_state state = {0.0, 0.0, 0.0, 0.0};
    if (velocity_rps == 0.0)
        return state;
    state.direction = velocity_rps > 0.0 ? 1.0 : -1.0;
    state.torque_nm = state.direction * steady_friction_nm(c, velocity_rps);
    return state;
}

