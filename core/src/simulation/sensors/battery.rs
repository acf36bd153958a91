//! The battery.

use super::config::BatteryConfig;

/// A reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BatteryReading {
    /// Simulated time [s].
    pub time: f64,
    /// Under load [V].
    pub voltage: f64,
    /// Drawn [A].
    pub current: f64,
    /// Charge left, 0 to 1.
    pub charge: f64,
    /// Whether the robot must stop.
    pub is_low: bool,
}

/// Energy that flows out, never in.
#[derive(Debug, Clone)]
pub struct Battery {
    config: BatteryConfig,
    charge: f64,
    current: f64,
}

impl Battery {
    /// A battery with this charge, 0 to 1.
    #[must_use]
    pub fn new(config: BatteryConfig, charge: f64) -> Self {
        Self { config, charge: charge.clamp(0.0, 1.0), current: 0.0 }
    }

    /// Draws the power of the motors [W] and of everything else for a time [s].
    pub fn draw(&mut self, motor_power: f64, step: f64) {
        let power = self.config.idle_power + motor_power.max(0.0) / self.config.efficiency;
        self.current = power / self.open_voltage();
        let lost = self.current * self.current * self.config.resistance;
        self.charge = (self.charge - (power + lost) * step / self.config.capacity).max(0.0);
    }

    /// What it says of itself.
    #[must_use]
    pub fn read(&self, time: f64) -> BatteryReading {
        let voltage = self.open_voltage() - self.current * self.config.resistance;
        let is_low = self.charge < self.config.low;
        BatteryReading { time, voltage, current: self.current, charge: self.charge, is_low }
    }

    fn open_voltage(&self) -> f64 {
        let [full, empty] = self.config.voltage;
        empty + self.charge * (full - empty)
    }
}
