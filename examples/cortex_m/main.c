/* The control loop of a microcontroller: torques that let no joint accelerate. Nothing is allocated. */

#include "arm.h"

/* Where a driver puts what it measured, and takes what is commanded. */
volatile float measured_q[ARM_NQ], measured_qd[ARM_NV], commanded_tau[ARM_NV];

int main(void)
{
    for (;;) {
        float q[ARM_NQ], qd[ARM_NV], tau[ARM_NV];
        for (int i = 0; i < ARM_NQ; i++) q[i] = measured_q[i];
        for (int i = 0; i < ARM_NV; i++) qd[i] = measured_qd[i];
        arm_bias_torque(q, qd, tau);
        for (int i = 0; i < ARM_NV; i++) commanded_tau[i] = tau[i];
    }
}
