//! The sensors' topics, drained into the filter.

use mirador_core::localization::{GnssSample, ImuSample, Localizer, MagneticSample, WheelSample};
use mirador_ipc_schema::{Participant, Subscriber, topics};
use mirador_service_common::ServiceError;

pub(crate) struct Sensors {
    imu: Subscriber<topics::Imu>,
    odometry: Subscriber<topics::Odometry>,
    gnss: Subscriber<topics::Gnss>,
    magnetometer: Subscriber<topics::Magnetometer>,
    refused: u64,
}

impl Sensors {
    pub fn open(participant: &Participant) -> Result<Self, ServiceError> {
        Ok(Self {
            imu: participant.subscriber()?,
            odometry: participant.subscriber()?,
            gnss: participant.subscriber()?,
            magnetometer: participant.subscriber()?,
            refused: 0,
        })
    }

    /// Takes everything in that has been said.
    pub fn drain(&mut self, localizer: &mut Localizer) -> Result<(), ServiceError> {
        while let Some(message) = self.imu.receive()? {
            for m in message.items() {
                let (acceleration, angular_velocity) = (m.acceleration.into(), m.angular_velocity.into());
                localizer.imu(ImuSample { stamp_ns: m.stamp_ns, acceleration, angular_velocity });
            }
        }
        while let Some(message) = self.odometry.receive()? {
            for m in message.items() {
                localizer.wheels(WheelSample { stamp_ns: m.stamp_ns, linear: m.linear, angular: m.angular });
            }
        }
        while let Some(message) = self.gnss.receive()? {
            for m in message.items().iter().filter(|m| m.fix > 0) {
                localizer.gnss(GnssSample {
                    stamp_ns: m.stamp_ns,
                    latitude: m.latitude,
                    longitude: m.longitude,
                    height: m.height,
                    velocity: m.velocity.into(),
                    sigma: m.sigma.into(),
                });
            }
        }
        while let Some(message) = self.magnetometer.receive()? {
            for m in message.items() {
                localizer.magnetometer(MagneticSample { stamp_ns: m.stamp_ns, field: m.field.into() });
            }
        }
        self.tell(localizer);
        Ok(())
    }

    /// Says what was refused, at the first, the second, the fourth time and so on.
    fn tell(&mut self, localizer: &Localizer) {
        let refused = localizer.counters().refused;
        let [imu, wheels] = [refused.imu.total(), refused.wheels.total()];
        let [gnss, magnetometer] = [refused.gnss.total(), refused.magnetometer.total()];
        let total = imu + wheels + gnss + magnetometer;
        if total > 0 && total >= 2 * self.refused {
            tracing::warn!(imu, wheels, gnss, magnetometer, "readings were refused: bad values or stamps");
            self.refused = total;
        }
    }
}
