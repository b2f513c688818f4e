//! Driver of an arm whose joints approach their position setpoints with a time constant.

use opspace_backend::{
    Backend, Capabilities, Command, CommandKind, DeviceFault, Driver, DriverError, DriverKey, KeyValue,
    RemoteStop, Sample, Settings,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

const KEYS: [DriverKey; 2] = [
    DriverKey::new("time_constant_s", KeyValue::Number, "Time constant of the joints, s.").required(),
    DriverKey::new("fails_after_s", KeyValue::Number, "Time of a fault, s.").with_default("never"),
];

/// Driver of the arm.
pub struct LaggingArmDriver;

impl Driver for LaggingArmDriver {
    fn name(&self) -> &str {
        "lagging-arm"
    }

    fn keys(&self) -> &[DriverKey] {
        &KEYS
    }

    fn with(&self, settings: &Settings, run: &mut dyn FnMut(&mut dyn Backend)) -> Result<(), DriverError> {
        settings.expect(&KEYS)?;
        if settings.command != CommandKind::Position {
            return Err(DriverError::new("this arm accepts only joint positions; use --backend position"));
        }
        let joints = settings.joints.len();
        let mut arm = LaggingArm {
            capabilities: Capabilities::new(settings.joints.clone(), settings.command, settings.period_s)
                .with_force_sensors(settings.force_sensors.clone()),
            gain: 1.0 - (-settings.period_s / settings.number("time_constant_s")?).exp(),
            fails_after_s: settings.number("fails_after_s").unwrap_or(f64::INFINITY),
            time_s: 0.0,
            q: vec![0.0; joints],
            setpoint: vec![0.0; joints],
            stopped: Arc::default(),
        };
        run(&mut arm);
        Ok(())
    }
}

struct LaggingArm {
    capabilities: Capabilities,
    gain: f64,
    fails_after_s: f64,
    time_s: f64,
    q: Vec<f64>,
    setpoint: Vec<f64>,
    stopped: Arc<AtomicBool>,
}

impl Backend for LaggingArm {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        if self.stopped.load(Ordering::Relaxed) {
            return Err(DeviceFault::new(18, "the arm was stopped from another thread"));
        }
        self.time_s += self.capabilities.period_s;
        if self.time_s > self.fails_after_s {
            return Err(DeviceFault::new(17, "the cable was pulled"));
        }
        for (q, setpoint) in self.q.iter_mut().zip(&self.setpoint) {
            *q += self.gain * (setpoint - *q);
        }
        sample.time_s = self.time_s;
        sample.q.copy_from_slice(&self.q);
        Ok(())
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        match command {
            Command::Position(q) => self.setpoint.copy_from_slice(q),
            Command::Hold => {}
            _ => return Err(DeviceFault::new(1, "this arm accepts only joint positions")),
        }
        Ok(())
    }

    /// Keeps the last setpoint.
    fn stop(&mut self) {}

    fn remote_stop(&self) -> Option<RemoteStop> {
        let stopped = Arc::clone(&self.stopped);
        Some(Box::new(move || stopped.store(true, Ordering::Relaxed)))
    }
}
