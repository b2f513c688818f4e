//! Tests of the watchdog of oscillation: deviations of known frequency, rate, rms and duration.

use crate::common::{Commanded, PERIOD_S, REST, at_rest, run};
use nalgebra::DVector;
use opspace_backend::{CommandKind, Sample};
use opspace_loop::{Fault, RunOutcome, Watchdog, WatchdogParameters};
use std::f64::consts::{PI, SQRT_2, TAU};
use std::sync::{Arc, Mutex};

const RATES_HZ: [f64; 5] = [1000.0, 500.0, 250.0, 125.0, 50.0];

/// Frequencies of oscillations, Hz; half the rate is added to them.
const FREQUENCIES_HZ: [f64; 4] = [16.0, 24.0, 50.0, 99.0];

const TORQUE_LIMIT_NM: f64 = 20.0;
/// Bound on the rms, Nm: 0.15 of the torque limit.
const BOUND_NM: f64 = 3.0;

/// Rms above the bound, as a multiple of it: the filter passes 0.8 at 16 Hz, and the rms of an interval of 0.08 s, which is no
/// multiple of the period, may be 6 % lower. At 24 Hz, samples at 50 Hz beat.
const ABOVE: f64 = 1.5;
/// Rms below the bound, as a multiple of it: the rms of an interval may be 6 % higher.
const BELOW: f64 = 0.9;
/// Transient of the filter, relative to the rms of an oscillation at 100 Hz.
const TRANSIENT: f64 = 0.05;
/// Rounding of a few operations on numbers of order 10.
const ROUNDING: f64 = 1e-12;

/// Time within which an oscillation must stop the arm, s.
const MOST_S: f64 = 0.5;

/// Times at which the deviation begins, s: one in each tenth of an interval of 0.08 s.
fn begins_s() -> impl Iterator<Item = f64> {
    (0..10).map(|k| 0.3 + 0.008 * f64::from(k))
}

/// Result of a watchdog whose second joint has this deviation (Nm), a function of the time since its beginning (s), in 2 s.
fn watch(rate_hz: f64, begin_s: f64, deviation: impl Fn(f64) -> f64) -> Result<(), (f64, Fault)> {
    let limits = [2.0 * TORQUE_LIMIT_NM, TORQUE_LIMIT_NM];
    let mut watchdog =
        Watchdog::new(&WatchdogParameters::default(), &limits, &[5.0, 5.0], &[], 1.0 / rate_hz);
    let desired = DVector::from_vec(vec![7.0, -3.0]);
    let (mut motor, dq) = (desired.clone(), DVector::zeros(2));
    for k in 0..(2.0 * rate_hz) as u32 {
        let since_s = f64::from(k) / rate_hz - begin_s;
        motor[1] = desired[1] + if since_s >= 0.0 { deviation(since_s) } else { 0.0 };
        watchdog.check(&motor, &desired, &dq).map_err(|fault| (since_s, fault))?;
    }
    Ok(())
}

/// Oscillation with this rms (Nm).
fn oscillation(rms: f64, frequency_hz: f64, rate_hz: f64) -> impl Fn(f64) -> f64 {
    // At half the rate, samples of a sine would be zero: the phase is that of an alternating signal.
    let is_alternating = 2.0 * frequency_hz == rate_hz;
    let amplitude = if is_alternating { rms } else { rms * SQRT_2 };
    move |since_s| {
        if is_alternating {
            amplitude * (PI * (since_s * rate_hz).round()).cos()
        } else {
            amplitude * (TAU * frequency_hz * since_s).sin()
        }
    }
}

/// Interface rates and the frequencies that they sample, Hz.
fn rates_and_frequencies() -> impl Iterator<Item = (f64, f64)> {
    RATES_HZ.into_iter().flat_map(|rate_hz| {
        let slower = FREQUENCIES_HZ.into_iter().filter(move |f| *f < 0.5 * rate_hz);
        slower.chain([0.5 * rate_hz]).map(move |frequency_hz| (rate_hz, frequency_hz))
    })
}

/// Compared: the time of the fault and 0.5 s, the joint and the limit. The rms is 1.5 times the bound, 2 times, or half of the torque
/// limit.
#[test]
fn oscillation_above_the_bound_stops_within_half_a_second() {
    for (rate_hz, frequency_hz) in rates_and_frequencies() {
        for begin_s in begins_s() {
            for rms in [ABOVE * BOUND_NM, 2.0 * BOUND_NM, 0.5 * TORQUE_LIMIT_NM] {
                let what = format!("{rms} Nm at {frequency_hz} Hz from {begin_s} s, {rate_hz} Hz");
                let stopped = watch(rate_hz, begin_s, oscillation(rms, frequency_hz, rate_hz));
                let Err((after_s, Fault::TorqueOscillation { joint: 1, rms: found, limit })) = stopped else {
                    panic!("{what}: {stopped:?}")
                };
                assert!(after_s <= MOST_S, "{what}: {after_s} s");
                assert!((limit - BOUND_NM).abs() < ROUNDING, "{what}: {limit} Nm");
                assert!(found > limit, "{what}: {found} Nm");
            }
        }
    }
}

/// Compared: the rms of the fault with the bound and with that of the oscillation, which is far above the corner frequency. The 0.4 s
/// begin before the oscillation.
#[test]
fn fault_has_the_rms_of_the_oscillation() {
    for rms in [1.1 * BOUND_NM, 2.0 * BOUND_NM] {
        let stopped = watch(1000.0, 0.3, oscillation(rms, 100.0, 1000.0));
        let Err((_, Fault::TorqueOscillation { rms: found, limit, .. })) = stopped else {
            panic!("{stopped:?}")
        };
        assert!((limit..(1.0 + TRANSIENT) * rms).contains(&found), "{found} Nm of {rms} Nm");
    }
}

#[test]
fn oscillation_below_the_bound_does_not_stop() {
    for (rate_hz, frequency_hz) in rates_and_frequencies() {
        let begin_s = 0.3;
        let result = watch(rate_hz, begin_s, oscillation(BELOW * BOUND_NM, frequency_hz, rate_hz));
        assert_eq!(result, Ok(()), "{frequency_hz} Hz, {rate_hz} Hz");
    }
}

/// Checks that a deviation at 5 Hz, nearly as large as the watchdog of the mean allows, does not count as oscillation. The mean, with a
/// time constant of 50 ms, reaches 0.63 of the amplitude in the first period, and 0.54 later; its bound is 0.6 of the torque limit.
#[test]
fn slow_deviation_is_no_oscillation() {
    let amplitude = 0.95 * 0.6 / 0.63 * TORQUE_LIMIT_NM;
    for rate_hz in RATES_HZ {
        for begin_s in begins_s() {
            let deviation = |since_s: f64| amplitude * (TAU * 5.0 * since_s).sin();
            assert_eq!(watch(rate_hz, begin_s, deviation), Ok(()), "{rate_hz} Hz from {begin_s} s");
        }
    }
}

/// Checks that an impact of 50 ms, at any time, does not count as oscillation: with one sign, nearly as large as the watchdog of the mean
/// allows, and with alternating signs, twice the torque limit, the largest difference of two torques within it.
#[test]
fn impact_is_no_oscillation() {
    const IMPACT_S: f64 = 0.05;
    for rate_hz in RATES_HZ {
        for begin_s in begins_s() {
            let during = |since_s: f64, torque: f64| if since_s < IMPACT_S { torque } else { 0.0 };
            let alternating = |frequency_hz: f64| {
                let sign = move |since_s: f64| (TAU * frequency_hz * since_s).cos().signum();
                watch(rate_hz, begin_s, move |since_s| during(since_s, 2.0 * TORQUE_LIMIT_NM * sign(since_s)))
            };
            let pushing = watch(rate_hz, begin_s, |since_s| during(since_s, 0.8 * TORQUE_LIMIT_NM));
            for result in [pushing, alternating(25.0), alternating(40.0)] {
                let is_oscillation = matches!(result, Err((_, Fault::TorqueOscillation { .. })));
                assert!(!is_oscillation, "{rate_hz} Hz from {begin_s} s: {result:?}");
            }
        }
    }
}

/// Checks that a restart of the watchdog clears what it has seen: three intervals before, and three after it.
#[test]
fn reset_clears_the_intervals() {
    let limits = [TORQUE_LIMIT_NM];
    let mut watchdog = Watchdog::new(&WatchdogParameters::default(), &limits, &[5.0], &[], 1e-3);
    let (desired, dq) = (DVector::zeros(1), DVector::zeros(1));
    for _ in 0..2 {
        for k in 0..240 {
            let motor = DVector::from_element(1, 2.0 * BOUND_NM * (PI * f64::from(k)).cos());
            assert_eq!(watchdog.check(&motor, &desired, &dq), Ok(()), "cycle {k}");
        }
        watchdog.reset();
    }
}

/// Checks that interfaces which sample no frequency above 15 Hz have no such watchdog.
#[test]
fn interface_of_30_hz_is_not_watched() {
    for rate_hz in [30.0, 20.0] {
        let result = watch(rate_hz, 0.3, oscillation(2.0 * BOUND_NM, 0.5 * rate_hz, rate_hz));
        assert_eq!(result, Ok(()), "{rate_hz} Hz");
    }
}

/// Compared: the fault of a complete control loop, and the time since the motor torque began to oscillate.
#[test]
fn oscillation_stops_a_run() {
    const AFTER: u64 = 60;
    for kind in [CommandKind::Position, CommandKind::Velocity] {
        let weight = Arc::new(Mutex::new(DVector::zeros(2)));
        let commanded = Arc::clone(&weight);
        let controller = Commanded::torques(move |data, _, tau| {
            tau.copy_from_slice(data.gravity.as_slice());
            commanded.lock().expect("one thread").copy_from(&data.gravity);
        });
        let script = move |cycle: u64, sample: &mut Sample| {
            at_rest(cycle, sample);
            let torque = sample.motor_torque.as_mut().expect("measured");
            torque.copy_from_slice(weight.lock().expect("one thread").as_slice());
            if cycle >= AFTER {
                torque[1] += ABOVE * BOUND_NM * SQRT_2 * (TAU * 24.0 * cycle as f64 * PERIOD_S).sin();
            }
        };
        let record = run(kind, controller, 1.0, script);
        let Fault::TorqueOscillation { joint: 1, .. } = *record.fault() else {
            panic!("{:?}", record.outcome)
        };
        let RunOutcome::Faulted { time_s, .. } = record.outcome else { panic!("{:?}", record.outcome) };
        let after_s = time_s - (AFTER - REST) as f64 * PERIOD_S;
        assert!(after_s <= MOST_S, "{after_s} s");
    }
}
