//! Requests and answers on Feetech's servo bus, and calibrations of its arms.

use crate::edits::{apply, edited};
use crate::inputs::for_each_input;
use crate::limits::Target;
use opspace_feetech::calibration::Calibration;
use opspace_feetech::protocol::{Decoded, Decoder, Encoder};
use opspace_feetech::simulated::{
    BusOptions, SeparateJoint, SeparateJoints, ServoOptions, SimulatedBus, SimulatedServo,
};
use std::time::Duration;

/// Most memory for one input, bytes.
const MOST_BYTES: usize = 1 << 20;

/// Whatever requests the simulated bus gets, it answers with valid packets of its servos, and its joints stay finite.
#[test]
#[ignore = "a fuzz target, which runs for a minute or longer: .ci/run fuzz"]
fn servo_bus() {
    let seeds = [requests(), Encoder::default().ping(2).to_vec()];
    let target = Target::new("servo_bus", MOST_BYTES);
    for_each_input(edited(seeds.len()), 3000, |(seed, edits)| {
        let bytes = apply(&seeds, *seed, edits);
        target.check(&bytes, edits.is_empty(), || {
            let servos = (1..4).map(|id| SimulatedServo::new(id, ServoOptions::default())).collect();
            let joints = SeparateJoints::new(vec![SeparateJoint::default(); 3], &[0.1, 0.2, 0.3]);
            let mut bus = SimulatedBus::new(servos, Box::new(joints), BusOptions::default());
            let mut time = Duration::ZERO;
            let mut answers = 0;
            for piece in bytes.chunks(7) {
                bus.receive(piece, time);
                time += Duration::from_millis(2);
                answers += valid_answers(&mut bus, time);
            }
            bus.advance_to(time + Duration::from_millis(200));
            assert!(bus.joints().q().iter().chain(bus.joints().dq()).all(|x| x.is_finite()));
            answers > 0
        });
    });
}

/// Takes the answers until a time, and returns their number.
fn valid_answers(bus: &mut SimulatedBus, time: Duration) -> usize {
    let (mut decoder, mut answers) = (Decoder::default(), 0);
    let mut buffer = [0; 64];
    loop {
        let taken = bus.take(&mut buffer, time);
        assert_eq!(decoder.push(&buffer[..taken]), taken);
        while let Some(decoded) = decoder.next_packet() {
            assert!(matches!(decoded, Decoded::Packet(_)), "{decoded:?}");
            answers += 1;
        }
        if taken == 0 {
            return answers;
        }
    }
}

/// One request of each kind.
fn requests() -> Vec<u8> {
    let mut encoder = Encoder::default();
    let mut bytes = encoder.ping(1).to_vec();
    bytes.extend(encoder.read(2, 56, 15));
    bytes.extend(encoder.write(3, 40, &[1]).expect("short"));
    bytes.extend(encoder.sync_read(56, 15, &[1, 2, 3]).expect("short"));
    bytes.extend(encoder.sync_write(42, [(1, [0, 8]), (3, [9, 7])].into_iter()).expect("short"));
    bytes
}

/// An error has a reason. An accepted calibration is the same after it was written and read again.
#[test]
#[ignore = "a fuzz target, which runs for a minute or longer: .ci/run fuzz"]
fn servo_calibration() {
    let ranges = [("shoulder", (-1.5, 1.2)), ("elbow", (-0.3, 2.0)), ("wrist", (-4.0, 4.0))];
    let calibration = Calibration::of_simulation(ranges).expect("a calibration");
    let seeds = [calibration.to_json().expect("a text").into_bytes()];
    let target = Target::new("servo_calibration", MOST_BYTES);
    for_each_input(edited(seeds.len()), 3000, |(seed, edits)| {
        let bytes = apply(&seeds, *seed, edits);
        target.check(&bytes, edits.is_empty(), || {
            let Ok(text) = std::str::from_utf8(&bytes) else { return false };
            match Calibration::from_json(text) {
                Ok(calibration) => {
                    let text = calibration.to_json().expect("a text");
                    assert_eq!(Calibration::from_json(&text).expect("the same"), calibration);
                    true
                }
                Err(error) => {
                    assert!(!error.to_string().is_empty(), "{error:?}");
                    false
                }
            }
        });
    });
}
