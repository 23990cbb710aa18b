/* The plant of fffo_drive/drive/simulated in C: five surfaces, current loop, resolver, noise; no effects.
 * The same equations in the same order on the same memory, for the benchmark of its step. */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include "declarations.h"

#define NEGLIGIBLE 25.0
#define ROUGH_RPS 0.5
#define TWO_PI 6.283185307179586

/* ---- noise: xoshiro128++ ---- */

static inline uint32_t rotated(uint32_t word, int bits)
{
    return word << bits | word >> (32 - bits);
}

static inline uint32_t random_word(int64_t *words)
{
    uint32_t s0 = (uint32_t)words[0], s1 = (uint32_t)words[1], s2 = (uint32_t)words[2], s3 = (uint32_t)words[3];
    uint32_t result = rotated(s0 + s3, 7) + s0;
    uint32_t shifted = s1 << 9;
    s2 ^= s0;
    s3 ^= s1;
    s1 ^= s2;
    s0 ^= s3;
    s2 ^= shifted;
    s3 = rotated(s3, 11);
    words[0] = s0;
    words[1] = s1;
    words[2] = s2;
    words[3] = s3;
    return result;
}

static inline double random_normal(int64_t *words)
{
    uint32_t a = random_word(words), b = random_word(words);
    int64_t total = (int64_t)(a & 0xFFFF) + (a >> 16) + (b & 0xFFFF) + (b >> 16);
    return (total - NORMAL_MEAN) * NORMAL_PER_DEVIATION;
}

/* ---- friction ---- */

static inline double stribeck_share(double ratio, double exponent)
{
    if (exponent == 2.0)
        ratio = ratio * ratio;
    else if (exponent != 1.0)
        ratio = pow(ratio, exponent);
    return ratio < NEGLIGIBLE ? exp(-ratio) : 0.0;
}

static inline double smaller(double a, double b) { return b < a ? b : a; }

static inline double contact_step(double load_nm, double level_nm, double elastic_share, double pull_nm)
{
    if (load_nm <= elastic_share * level_nm)
        return smaller(level_nm, load_nm + pull_nm);
    if (load_nm >= level_nm)
        return (load_nm + pull_nm) * (level_nm / (level_nm + pull_nm));
    double yielding_nm = load_nm - elastic_share * level_nm;
    double span_nm = (1.0 - elastic_share) * level_nm;
    double whole = span_nm * span_nm * span_nm;
    double alpha_of_whole = yielding_nm * yielding_nm * (3.0 * span_nm - 2.0 * yielding_nm);
    return smaller(level_nm, (load_nm + pull_nm) * (level_nm * whole / (level_nm * whole + alpha_of_whole * pull_nm)));
}

static double surfaces_step(const double (*restrict table)[TABLE_COLUMNS], double (*restrict state)[STATE_COLUMNS],
                            int64_t surfaces, double velocity_rps, double level, double viscous_scale)
{
    double direction = velocity_rps > 0.0 ? 1.0 : -1.0;
    double speed_rps = fabs(velocity_rps);
    double travel_rev = speed_rps * STEP_S;
    double load_nm = 0.0, viscous = 0.0;
    for (int64_t k = 0; k < surfaces; k++) {
        viscous += table[k][VISCOUS_NM_PER_RPS];
        double contact_nm = direction * state[k][CONTACT_NM];
        if (speed_rps > 0.0) {
            double renewed = travel_rev * table[k][MEMORY];
            double kept = 1.0 / (1.0 + renewed);
            double steady = stribeck_share(speed_rps * table[k][PER_STRIBECK_RPS], table[k][STRIBECK_EXPONENT]);
            double stiction = (state[k][STICTION] + renewed * steady) * kept;
            state[k][STICTION] = stiction;
            double level_nm = level * (table[k][COULOMB_NM] + table[k][RISE_NM] * stiction);
            contact_nm = contact_step(contact_nm, level_nm, table[k][ELASTIC_SHARE], table[k][STIFFNESS] * travel_rev);
            state[k][CONTACT_NM] = direction * contact_nm;
        }
        load_nm += contact_nm;
    }
    return direction * load_nm + viscous_scale * viscous * velocity_rps;
}

/* ---- transport, current loop, resolver ---- */

static inline double transport_step(double *restrict line, int64_t length, int64_t *words, int64_t steps,
                                    double fraction, double command_a)
{
    int64_t head = words[HEAD];
    line[head] = command_a;
    int64_t newer = head - steps;
    if (newer < 0)
        newer += length;
    int64_t older = newer - 1;
    if (older < 0)
        older += length;
    head += 1;
    words[HEAD] = head < length ? head : 0;
    return (1.0 - fraction) * line[newer] + fraction * line[older];
}

static inline double current_step(const double *restrict c, double *restrict x, int64_t *words, double demand_a)
{
    double kept = c[CURRENT_KEPT], current_a = x[CURRENT_A];
    if (words[SUBSTEP] % 2 == 0) {
        double back_emf_v = c[BACK_EMF] * x[VELOCITY_RPS];
        double peak_a = c[PEAK_CURRENT_A];
        double target_a = demand_a > peak_a ? peak_a : demand_a < -peak_a ? -peak_a : demand_a;
        double wanted_a = current_a + c[CURRENT_APPROACH] * (target_a - current_a);
        double wanted_v = back_emf_v + c[V_PER_CURRENT] * (wanted_a - kept * kept * current_a);
        double limit_v = c[DC_LINK_V];
        double voltage_v = wanted_v > limit_v ? limit_v : wanted_v < -limit_v ? -limit_v : wanted_v;
        x[WINDING_V] = voltage_v - back_emf_v;
        if (voltage_v != wanted_v || target_a != demand_a)
            words[LIMITED] = 1;
    }
    double next_a = kept * current_a + c[CURRENT_PER_V] * x[WINDING_V];
    x[CURRENT_A] = next_a;
    return 0.5 * (current_a + next_a);
}

static inline void resolver_step(const double *restrict c, double *restrict x, int64_t *words, double sensed_rev)
{
    double noise_rev = c[RESOLVER_NOISE_REV];
    if (noise_rev > 0.0)
        sensed_rev += noise_rev * random_normal(words);
    double converted_rev = (floor(sensed_rev * c[COUNTS_PER_REV]) + 0.5) * c[REV_PER_COUNT];
    double predicted_rev = x[TRACKED_REV] + x[TRACKED_RPS] * STEP_S;
    double error_rev = converted_rev - predicted_rev;
    x[TRACKED_REV] = predicted_rev + c[TRACKING_POSITION] * error_rev;
    x[TRACKED_RPS] += c[TRACKING_VELOCITY] * error_rev;
}

/* ---- the plant ---- */

static void plant_advance(struct plant_parameters *p, struct plant_state *s, double command_a, int64_t substeps)
{
    const double *restrict c = p->numbers;
    double *restrict x = s->values;
    int64_t *words = s->words;
    int64_t transport = p->integers[TRANSPORT_STEPS];
    for (int64_t k = 0; k < substeps; k++) {
        double demand_a = transport_step(s->delay_line, s->delay_line_n, words, transport, c[TRANSPORT_FRACTION], command_a);
        double current_a = current_step(c, x, words, demand_a);
        double torque_nm = c[TORQUE_CONSTANT] * current_a;
        double temperature_k = x[TEMPERATURE_K];
        double level = 1.0 + c[COULOMB_PER_K] * temperature_k;
        double viscous_scale = 1.0 + c[VISCOUS_PER_K] * temperature_k;
        double velocity_rps = x[VELOCITY_RPS];
        double friction_nm = surfaces_step((const double (*)[TABLE_COLUMNS])p->friction, s->friction, p->friction_n,
                                           velocity_rps, level, viscous_scale);
        if (c[ROUGHNESS_NM] != 0.0) {
            x[ROUGH_NM] = c[ROUGHNESS_KEPT] * x[ROUGH_NM] + c[ROUGHNESS_NM] * random_normal(words);
            double speed_rps = fabs(velocity_rps);
            friction_nm += x[ROUGH_NM] * speed_rps / (speed_rps + ROUGH_RPS);
        }
        x[FRICTION_NM] = friction_nm;
        x[TORQUE_NM] = torque_nm;
        double next_rps = velocity_rps + c[SPEED_PER_TORQUE] * (torque_nm - friction_nm - c[OFFSET_NM_PER_K] * temperature_k);
        x[VELOCITY_RPS] = next_rps;
        double angle_rev = x[ANGLE_REV] + 0.5 * (velocity_rps + next_rps) * STEP_S;
        x[ANGLE_REV] = angle_rev;
        double winding_a = x[CURRENT_A];
        double loss_w = c[RESISTANCE_OHM] * winding_a * winding_a;
        loss_w += TWO_PI * fabs(friction_nm * next_rps);
        x[TEMPERATURE_K] = temperature_k + (c[WARMING_K_PER_W] * loss_w - c[COOLING] * temperature_k);
        resolver_step(c, x, words, angle_rev);
        words[SUBSTEP] += 1;
    }
}

static double plant_latch(struct plant_parameters *p, struct plant_state *s)
{
    const double *restrict c = p->numbers;
    double *restrict x = s->values;
    double velocity_rps = x[TRACKED_RPS] + c[VELOCITY_NOISE_RPS] * random_normal(s->words);
    double lsb_rps = c[VELOCITY_LSB_RPS];
    if (lsb_rps > 0.0)
        velocity_rps = floor(velocity_rps / lsb_rps + 0.5) * lsb_rps;
    s->words[LIMITED] = 0;
    random_normal(s->words); /* of the measured current */
    return velocity_rps;
}

void drive_plant(struct plant_parameters *p, struct plant_state *s, const double *commands_a, double *velocities_rps,
                 int64_t ticks, int64_t substeps)
{
    for (int64_t tick = 0; tick < ticks; tick++) {
        plant_advance(p, s, commands_a[tick], substeps);
        velocities_rps[tick] = plant_latch(p, s);
    }
}
