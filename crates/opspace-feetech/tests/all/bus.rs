//! Single requests.

use crate::common::{IDS, bus};
use opspace_feetech::bus::Bus;
use opspace_feetech::protocol::Register;
use opspace_feetech::simulated::SimulatedTransport;
use std::time::Duration;

/// An answer that comes after a request was repeated is not taken for one to the next request: values are right or missing.
#[test]
fn late_answers_are_not_taken_for_others() {
    for latency_ms in [40, 49, 51, 60, 80, 99, 101, 120, 149] {
        let mut simulated = bus();
        simulated.options.latency = Duration::from_millis(latency_ms);
        let expected: Vec<_> = IDS.iter().filter_map(|id| simulated.servo(*id)).cloned().collect();
        let mut bus = Bus::new(SimulatedTransport::new(simulated));
        let mut answered = 0;
        for servo in &expected {
            for register in [
                Register::MIN_POSITION_LIMIT,
                Register::MAX_POSITION_LIMIT,
                Register::HOMING_OFFSET,
                Register::ID,
            ] {
                if let Ok(value) = bus.read(servo.id(), register) {
                    assert_eq!(value, servo.get(register), "{latency_ms} ms: {}", register.name);
                    answered += 1;
                }
            }
        }
        assert_eq!(answered, 12, "{latency_ms} ms");
    }
}

#[test]
fn servos_that_exist_answer() {
    let mut bus = Bus::new(SimulatedTransport::new(bus()));
    let found: Vec<u8> =
        (0..20).filter(|id| bus.answers(*id, Duration::from_millis(5)).expect("a port")).collect();
    assert_eq!(found, IDS);
}
