/* The two-link arm of the 2014 paper under PI torque control, written by hand for a vector unit.

   A yardstick for throughput, not a part of the product: classical RK4 and the mean square of the
   torque error of both joints, summed over the ticks. Sine and cosine are the polynomials that
   the engine uses, without the reduction to an eighth of a turn's last bits. LANES arms advance
   together, one per element of a vector; groups of arms go over threads. REAL is double or float.

   State of joint j: [6 j] theta_L, omega_L, theta_B, omega_M, current, integral of the error. */
#include "lanes.h"

#define STATES 12

static const REAL L = 0.32e-3, R = 0.664, K_t = 0.041, K_w = 0.041, J_M = 1.387e-5, D_M = 1.996e-5,
                  K_2 = 912, N = 150, inertia_1 = 0.3047, inertia_2 = 0.0871, coupling = 0.0954,
                  gravity_1 = 6.6438, gravity_2 = 1.034, D_L = 0.01, K_p = 2,
                  reference_1 = 3, start_2 = 0.5;
static const REAL K_i[2] = {12.5, 25};

static inline void sincos_(REAL x, REAL *sine, REAL *cosine)
{
    REAL q = nearbyint(x * (REAL)0.63661977236758134308);
    REAL r = x - q * (REAL)1.57079632673412561417e+00;
    r = r - q * (REAL)6.07710050630396597660e-11;
    r = r - q * (REAL)2.02226624879595063154e-21;
    REAL z = r * r, half = (REAL)0.5 * z, near = 1 - half;
    REAL s = (REAL)1.58969099521155010221e-10;
    s = s * z - (REAL)2.50507602534068634195e-08;
    s = s * z + (REAL)2.75573137070700676789e-06;
    s = s * z - (REAL)1.98412698298579493134e-04;
    s = s * z + (REAL)8.33333333332248946124e-03;
    s = s * z - (REAL)1.66666666666666324348e-01;
    REAL c = (REAL)-1.13596475577881948265e-11;
    c = c * z + (REAL)2.08757232129817482790e-09;
    c = c * z - (REAL)2.75573143513906633035e-07;
    c = c * z + (REAL)2.48015872894767294178e-05;
    c = c * z - (REAL)1.38888888888741095749e-03;
    c = c * z + (REAL)4.16666666666666019037e-02;
    s = r + r * (z * s);
    c = near + (((1 - near) - half) + z * z * c);
    REAL turn = q - 4 * floor((REAL)0.25 * q);
    int odd = turn == 1 || turn == 3;
    REAL first = odd ? c : s, second = odd ? s : c;
    *sine = turn > (REAL)1.5 ? -first : first;
    *cosine = turn == 1 || turn == 2 ? -second : second;
}

static inline void motor(const lanes *restrict s, int l, REAL torque, REAL error, REAL gain,
                         lanes *restrict out)
{
    REAL command = K_p * (error + gain * s[5][l]);
    out[0][l] = s[1][l];
    out[2][l] = s[3][l] * (1 / N) - s[1][l];
    out[3][l] = (K_t * s[4][l] - D_M * s[3][l] - torque * (1 / N)) * (1 / J_M);
    out[4][l] = (command - R * s[4][l] - K_w * s[3][l]) * (1 / L);
    out[5][l] = error;
}

static inline void field(const lanes *restrict s, const REAL *stiffness, lanes *restrict out)
{
    const REAL least = inertia_2 * (inertia_1 - inertia_2) - coupling * coupling;
    _Pragma("omp simd")
    EACH {
        REAL sine_1, cosine_1, sine, cosine;
        sincos_(s[0][l], &sine_1, &cosine_1);
        sincos_(s[6][l], &sine, &cosine);
        REAL w1 = s[1][l], w2 = s[7][l];
        REAL torque_1 = stiffness[l] * s[2][l], torque_2 = K_2 * s[8][l];
        REAL swing = coupling * sine;
        REAL hang = gravity_2 * (sine_1 * cosine + cosine_1 * sine);
        REAL rest_1 = torque_1 + swing * (2 * w1 * w2 + w2 * w2) - D_L * w1
                      - gravity_1 * sine_1 - hang;
        REAL rest_2 = torque_2 - swing * w1 * w1 - D_L * w2 - hang;
        REAL M_11 = inertia_1 + 2 * coupling * cosine, M_12 = inertia_2 + coupling * cosine;
        REAL inverse = 1 / (least + swing * swing);
        motor(s, l, torque_1, reference_1 - torque_1, K_i[0], out);
        motor(s + 6, l, torque_2, -torque_2, K_i[1], out + 6);
        out[1][l] = (inertia_2 * rest_1 - M_12 * rest_2) * inverse;
        out[7][l] = (M_11 * rest_2 - M_12 * rest_1) * inverse;
    }
}

static void step(lanes *s, const REAL *stiffness, REAL dt)
{
    lanes k[STATES], sum[STATES], trial[STATES];
    field(s, stiffness, k);
    for (int i = 0; i < STATES; i++) EACH {
        sum[i][l] = k[i][l];
        trial[i][l] = s[i][l] + (REAL)0.5 * dt * k[i][l];
    }
    field(trial, stiffness, k);
    for (int i = 0; i < STATES; i++) EACH {
        sum[i][l] += 2 * k[i][l];
        trial[i][l] = s[i][l] + (REAL)0.5 * dt * k[i][l];
    }
    field(trial, stiffness, k);
    for (int i = 0; i < STATES; i++) EACH {
        sum[i][l] += 2 * k[i][l];
        trial[i][l] = s[i][l] + dt * k[i][l];
    }
    field(trial, stiffness, k);
    for (int i = 0; i < STATES; i++) EACH s[i][l] += dt / 6 * (sum[i][l] + k[i][l]);
}

static void group(const REAL *stiffness, int steps, REAL dt, REAL *square_1, REAL *square_2)
{
    lanes s[STATES] = {{0}};
    EACH {
        s[6][l] = start_2;
        square_1[l] = (REAL)0.5 * dt * reference_1 * reference_1;
        square_2[l] = 0;
    }
    for (int n = 1; n <= steps; n++) {
        step(s, stiffness, dt);
        REAL weight = n == steps ? (REAL)0.5 * dt : dt;
        EACH {
            REAL error_1 = reference_1 - stiffness[l] * s[2][l], error_2 = K_2 * s[8][l];
            square_1[l] += weight * error_1 * error_1;
            square_2[l] += weight * error_2 * error_2;
        }
    }
}

/* stiffness of joint 1, the integrals of the squared errors: (arms,) arrays; arms a multiple of
   LANES. */
void run(const REAL *stiffness, long arms, int steps, REAL dt, REAL *square_1, REAL *square_2)
{
#pragma omp parallel for schedule(static)
    for (long g = 0; g < arms; g += LANES)
        group(stiffness + g, steps, dt, square_1 + g, square_2 + g);
}
