/* The simulation inside the fit, in C: fffo_drive/model/axis.simulate_into. */
#include "friction.h"

static void axis_step(const struct axis_config *c, struct axis_state *state, double torque_nm, double period_s)
{
    double half_kick = 0.5 * period_s / c->inertia_nm_s2_per_rev;
    double drift_rps = state->velocity_rps + half_kick * (torque_nm - state->friction.torque_nm);
    friction_step(&c->friction, &state->friction, drift_rps, 0.0, period_s);
    state->velocity_rps = drift_rps + half_kick * (torque_nm - state->friction.torque_nm);
    state->position_rev += drift_rps * period_s;
}

static double held_command(const double *command, int64_t n, double time_in_samples)
{
    int64_t index = (int64_t)floor(time_in_samples);
    if (index < 0)
        return 0.0;
    return command[index < n - 1 ? index : n - 1];
}

static double mean_held_command(const double *command, int64_t n, double begin, double end)
{
    double edge = floor(begin) + 1.0;
    double first = held_command(command, n, begin);
    if (edge >= end)
        return first;
    double second = held_command(command, n, edge);
    return (first * (edge - begin) + second * (end - edge)) / (end - begin);
}

void simulate(const struct axis_config *c, struct axis_state *state, const double *current_a, int64_t n, double period_s,
              int64_t substeps, double (*output)[3])
{
    double step_s = period_s / (double)substeps;
    double delay_samples = c->delay_s / period_s;
    for (int64_t k = 0; k < n; k++) {
        output[k][0] = state->velocity_rps;
        output[k][1] = state->position_rev;
        output[k][2] = state->friction.torque_nm;
        for (int64_t j = 0; j < substeps; j++) {
            double begin = (double)k + (double)j / (double)substeps - delay_samples;
            double current = mean_held_command(current_a, n, begin, begin + 1.0 / (double)substeps);
            axis_step(c, state, c->torque_constant_nm_per_a * current, step_s);
        }
    }
}
