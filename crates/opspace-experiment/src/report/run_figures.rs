//! Figures of one run: torques, their errors, the tasks, setpoints and computing times. All are computed from the log.

use crate::evaluate::metrics::cycle_times_ns;
use crate::evaluate::metrics::run_log::Run;
use crate::evaluate::spectrum::windowed_transform;
use crate::report::figure::{Figure, Panel, Scale, Series, Style};
use crate::report::lines::{COLUMNS, draw_limits, element, joint_figure, label_of, time_panel};
use crate::report::task_figures::task_figures;
use crate::run::experiment::Experiment;
use opspace_backend::signal_names::{
    DQ, DQ_DESIRED, MOTOR_TORQUE, Q, Q_DESIRED, SERVO_CHANNEL, TORQUE_DESIRED,
};
use opspace_log::Recording;
use realfft::RealFftPlanner;

/// Creates the figures of a run: torques by joint, then the signals of its tasks and sensors.
#[must_use]
pub(super) fn figures(experiment: &Experiment, recording: &Recording) -> Vec<Figure> {
    let Some(run) = Run::new(experiment, recording) else { return Vec::new() };
    let mut figures: Vec<Figure> = torques(&run).into_iter().collect();
    figures.extend(task_figures(&run));
    figures.extend(setpoint_figure(&run));
    figures.extend(torque_error_spectrum(&run));
    figures.extend(computing_times(&run));
    figures
}

/// Figure of desired and motor torque of each joint, at servo rate if the log contains it.
fn torques(run: &Run<'_>) -> Option<Figure> {
    let (channel, caption) = match run.recording.channel(SERVO_CHANNEL) {
        Some(servo) => (servo, "True motor torque, mean over each servo period, and desired torque."),
        None => (run.tick, "Motor torque measured by current, and desired torque."),
    };
    let motor = channel.signal(MOTOR_TORQUE)?;
    let desired = channel.signal(TORQUE_DESIRED);
    let limits = run.experiment.robot().torque_limits();
    let panel = |(j, joint): (usize, &String)| {
        let lines = [("motor", Style::Solid, Some(motor)), ("desired", Style::Desired, desired)];
        let series = lines
            .into_iter()
            .filter_map(|(label, style, column)| element(run, label, &channel.time_s, &column?, j, style));
        let mut panel = time_panel(joint, &label_of("torque", &motor, j), series.collect());
        let limit = limits.get(j).copied().unwrap_or(f64::INFINITY);
        draw_limits(&mut panel, -limit..limit);
        panel
    };
    Some(Figure {
        title: "Desired and motor torque".to_owned(),
        caption: format!("{caption} Torque limits are drawn where the torques come near them."),
        panels: motor.elements().iter().enumerate().map(panel).collect(),
        overlays: true,
        ..Figure::default()
    })
}

/// Figure of setpoints and measured values: velocities for a velocity robot, positions for a position robot.
fn setpoint_figure(run: &Run<'_>) -> Option<Figure> {
    if let Some(velocities) = run.tick.signal(DQ_DESIRED) {
        return joint_figure(
            run,
            "Setpoints",
            "Velocity setpoints (commands of the velocity servos), and measured or estimated velocities.",
            "velocity",
            (run.tick, DQ, "measured"),
            &velocities,
        );
    }
    let positions = run.tick.signal(Q_DESIRED)?;
    let caption = "Position setpoints (commands of the position servos), and measured positions.";
    joint_figure(run, "Setpoints", caption, "position", (run.tick, Q, "measured"), &positions)
}

/// Figure of the spectrum of the torque error of each joint, at servo rate, after settling: where motor torque and desired
/// torque differ. `None` without a true motor torque.
fn torque_error_spectrum(run: &Run<'_>) -> Option<Figure> {
    let servo = run.recording.channel(SERVO_CHANNEL)?;
    let (motor, desired) = (servo.signal(MOTOR_TORQUE)?, servo.signal(TORQUE_DESIRED)?);
    let profile = run.experiment.profile().1;
    let rows = run.settled(&servo.time_s);
    let mut planner = RealFftPlanner::new();
    let panels: Vec<Panel> = (motor.elements().iter().enumerate())
        .filter_map(|(j, joint)| {
            let errors: Vec<f64> = rows.clone().map(|k| motor.row(k)[j] - desired.row(k)[j]).collect();
            let (hz, amplitude) = spectrum(&errors, profile.servo_hz.get(), &mut planner)?;
            let mut panel = Panel {
                title: joint.clone(),
                x_label: "frequency (Hz)".to_owned(),
                y_label: label_of("amplitude", &motor, j),
                series: vec![Series::new("motor minus desired torque", hz, amplitude).thinned(COLUMNS)],
                x_scale: Scale::Log,
                y_scale: Scale::Log,
                ..Panel::default()
            };
            if profile.servo_ticks_per_cycle.get() > 1 {
                panel.marks.push((1.0 / profile.period_s(), "interface rate".to_owned()));
            }
            Some(panel)
        })
        .collect();
    (!panels.is_empty()).then(|| Figure {
        title: "Spectrum of the torque error".to_owned(),
        caption: "Amplitude by frequency after settle_s, rms over segments of one second (Hann window, Welch). A held setpoint \
                  gives lines at multiples of the interface rate; friction, noise and the transformer's model errors are \
                  below it."
            .to_owned(),
        panels,
        ..Figure::default()
    })
}

/// Returns frequencies (Hz) and amplitudes of a signal, rms over segments of a second that overlap by half, with a Hann
/// window (P. D. Welch, 1967); `None` if the signal is too short or has gaps.
fn spectrum(
    samples: &[f64],
    rate_hz: f64,
    planner: &mut RealFftPlanner<f64>,
) -> Option<(Vec<f64>, Vec<f64>)> {
    let n = samples.len().min(rate_hz.round() as usize);
    let mut squares = vec![0.0; n / 2 + 1];
    let mut segments = 0.0;
    for start in (0..=samples.len() - n).step_by(n.div_ceil(2).max(1)) {
        let lines = windowed_transform(&samples[start..start + n], planner)?;
        // The mean of the window is one half, and a line stands for two.
        squares.iter_mut().zip(&lines).for_each(|(sum, line)| *sum += (4.0 * line.norm() / n as f64).powi(2));
        segments += 1.0;
    }
    let amplitudes = squares.iter().skip(1).map(|sum| (sum / segments).sqrt()).collect();
    let frequencies = (1..squares.len()).map(|line| line as f64 * rate_hz / n as f64).collect();
    Some((frequencies, amplitudes))
}

/// Histogram of the durations of the control cycles.
fn computing_times(run: &Run<'_>) -> Option<Figure> {
    const BINS: usize = 60;
    let times_us: Vec<f64> = cycle_times_ns(run.recording)
        .into_iter()
        .map(|time| 1e-3 * time)
        .filter(|time| *time > 0.0)
        .collect();
    let (least, largest) = (*times_us.first()?, *times_us.last()?);
    // Bins of equal ratio: a few cycles take a hundred times longer than the others.
    let ratio = (largest / least).max(1.1).powf(1.0 / BINS as f64);
    let (mut x, mut y) = (Vec::new(), Vec::new());
    let mut counted = 0;
    for bin in 0..BINS {
        let (from, to) = (least * ratio.powf(bin as f64), least * ratio.powf(bin as f64 + 1.0));
        let until = if bin + 1 == BINS { times_us.len() } else { times_us.partition_point(|t| *t < to) };
        let count = until.saturating_sub(counted) as f64;
        counted = until;
        // Steps; an empty bin interrupts the line, as a logarithmic axis has no zero.
        x.extend([from, to]);
        y.extend([if count > 0.0 { count } else { f64::NAN }; 2]);
    }
    let at = |share: f64| times_us[((times_us.len() - 1) as f64 * share).round() as usize];
    let panel = Panel {
        x_label: "duration of a control cycle (µs)".to_owned(),
        y_label: "cycles".to_owned(),
        series: vec![Series::new("cycles", x, y)],
        marks: vec![(at(0.5), "median".to_owned()), (at(0.99), "99 %".to_owned())],
        x_scale: Scale::Log,
        y_scale: Scale::Log,
        ..Panel::default()
    };
    Some(Figure {
        title: "Computing time".to_owned(),
        caption: "Number of control cycles by duration: estimator, model, controller and transformer, without communication. \
                  Measured on the computer of this run, among its other work."
            .to_owned(),
        panels: vec![panel],
        ..Figure::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// Rounding of a transform of a thousand samples, N·m.
    const ROUNDING: f64 = 1e-9;

    /// Compared: the amplitudes at the frequencies of two sines, and these sines' amplitudes.
    #[test]
    fn spectrum_has_the_amplitudes_of_sines() {
        let rate_hz = 1000.0;
        let samples: Vec<f64> = (0..5300)
            .map(|k| f64::from(k) / rate_hz)
            .map(|t| 7.0 + 0.5 * (TAU * 20.0 * t).sin() + 0.02 * (TAU * 310.0 * t).cos())
            .collect();
        let (hz, amplitude) = spectrum(&samples, rate_hz, &mut RealFftPlanner::new()).expect("a spectrum");
        assert_eq!((hz[0], hz[19], hz[309]), (1.0, 20.0, 310.0));
        assert!((amplitude[19] - 0.5).abs() < ROUNDING && (amplitude[309] - 0.02).abs() < ROUNDING);
        assert!(amplitude[99] < ROUNDING, "{}", amplitude[99]);
        assert_eq!(spectrum(&samples[..20], rate_hz, &mut RealFftPlanner::new()), None);
    }
}
