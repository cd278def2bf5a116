/* Drives that advance together, one per element of a vector; the compiler is given REAL and LANES. */
#include <math.h>

#ifndef REAL
#define REAL double
#endif
#ifndef LANES
#define LANES 32
#endif
#define EACH for (int l = 0; l < LANES; l++)

typedef REAL lanes[LANES];
