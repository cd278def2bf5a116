/* The bench's closed loop written by hand for a vector unit: the practical limit of the machine.

   A yardstick for throughput, not a part of the product: classical RK4 without event location and
   without gradients, and the three metrics as folds over the ticks. LANES drives advance together,
   one per element of a vector; groups of drives go over threads. REAL is double or float.

   State: omega_L, omega_M, theta_L, theta_B, derivative filter, reference filter. */
#include "lanes.h"

#define STATES 6

static const REAL J_M = 8.78e-4, D_M = 9.30e-2, K = 3.00e2, D_B = 1.00e-1, J_L = 8.78e-4,
                  D_L = 3.60e-2;
static const REAL K_P = 10.28129662037006, K_D = 0.05470907749696041, tau_D = 5.82812354062619e-3,
                  K_B = -0.80, omega_f = 2.0 * 3.14159265358979323846 * 20.0;

static inline REAL joint_torque(REAL theta_B, REAL omega_B, REAL half_gap)
{
    REAL above = theta_B - half_gap, below = theta_B + half_gap;
    REAL rate = D_B * omega_B;
    REAL right = theta_B >= half_gap ? rate + K * above : (REAL)0;
    return theta_B <= -half_gap ? rate + K * below : right;
}

static inline void field(const lanes *s, REAL reference, const REAL *half_gap, lanes *out)
{
    EACH {
        REAL omega_L = s[0][l], omega_M = s[1][l], error = s[5][l] - s[2][l];
        REAL omega_B = omega_M - omega_L;
        REAL torque = joint_torque(s[3][l], omega_B, half_gap[l]);
        REAL slope = (error - s[4][l]) * (1 / tau_D);
        REAL damping = omega_B * omega_L >= 0 ? K_B * omega_B : (REAL)0;
        REAL command = K_P * error + K_D * slope + damping;
        out[0][l] = (torque - D_L * omega_L) * (1 / J_L);
        out[1][l] = (command - D_M * omega_M - torque) * (1 / J_M);
        out[2][l] = omega_L;
        out[3][l] = omega_B;
        out[4][l] = slope;
        out[5][l] = omega_f * (reference - s[5][l]);
    }
}

static void step(lanes *s, REAL reference, const REAL *half_gap, REAL dt)
{
    lanes k[STATES], sum[STATES], trial[STATES];
    field(s, reference, half_gap, k);
    for (int i = 0; i < STATES; i++) EACH {
        sum[i][l] = k[i][l];
        trial[i][l] = s[i][l] + (REAL)0.5 * dt * k[i][l];
    }
    field(trial, reference, half_gap, k);
    for (int i = 0; i < STATES; i++) EACH {
        sum[i][l] += 2 * k[i][l];
        trial[i][l] = s[i][l] + (REAL)0.5 * dt * k[i][l];
    }
    field(trial, reference, half_gap, k);
    for (int i = 0; i < STATES; i++) EACH {
        sum[i][l] += 2 * k[i][l];
        trial[i][l] = s[i][l] + dt * k[i][l];
    }
    field(trial, reference, half_gap, k);
    for (int i = 0; i < STATES; i++) EACH s[i][l] += dt / 6 * (sum[i][l] + k[i][l]);
}

static void group(const REAL *half_gap, int steps, REAL dt, REAL *peak, REAL *top, REAL *itae)
{
    lanes s[STATES] = {{0}};
    EACH peak[l] = top[l] = itae[l] = 0;
    for (int n = 0; n < steps; n++) {
        REAL time = n * dt, since = (n + 1) * dt - (REAL)0.010;
        step(s, time >= (REAL)(0.010 - 1e-9) ? (REAL)0.30 : (REAL)0, half_gap, dt);
        EACH {
            REAL torque = joint_torque(s[3][l], s[1][l] - s[0][l], half_gap[l]);
            REAL size = torque < 0 ? -torque : torque;
            REAL error = (REAL)0.30 - s[2][l];
            peak[l] = size > peak[l] ? size : peak[l];
            top[l] = s[2][l] > top[l] ? s[2][l] : top[l];
            itae[l] += since > 0 ? dt * since * (error < 0 ? -error : error) : (REAL)0;
        }
    }
}

/* half_gap, peak, top, itae: (drives,) arrays; drives a multiple of LANES. */
void run(const REAL *half_gap, long drives, int steps, REAL dt, REAL *peak, REAL *top, REAL *itae)
{
#pragma omp parallel for schedule(static)
    for (long g = 0; g < drives; g += LANES)
        group(half_gap + g, steps, dt, peak + g, top + g, itae + g);
}
