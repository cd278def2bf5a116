"""Linear analysis of drives at an operating point, in float64 with NumPy and SciPy.

state_space   StateSpace with named signals, interconnect, poles
zeros         zeros of any channel of a StateSpace
polynomial    matrix polynomials and their block companion form
joints        JointSystem (2)-(5) of the 2014 paper, Gammas, Q, Y, transmission zeros, plant
torque_loop   TorqueLaw, Lead, Butterworth; Lemma 6, closed and open loop, disturbances
routh         bounds (21), (22) and the stability region
stability     exact stability intervals of a gain, a second method, root loci
frequency     response, Bode data, bandwidth, peak, margins
step          step response and overshoot
linearise     from a Drive or ClosedLoop at an operating point, in a contact mode
"""
