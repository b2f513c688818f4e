//! Figures of one run: torques, their errors, the tasks, setpoints and computing times. All are computed from the log.

use crate::collision_moments::{CollisionMoment, CollisionMoments};
use crate::energy_figure::energy_figure;
use crate::event_times::EventTimes;
use crate::figure::{Figure, Panel, Scale, Series, Style};
use crate::lines::{COLUMNS, append, complete, element, joint_figure, label_of, time_panel};
use crate::path_figures::PathFigures;
use crate::response_figures::ResponseFigures;
use crate::run_pictures::{PictureRows, RunPictures};
use crate::slack_figure::slack_figure;
use crate::task_figures::{FORCE, task_figures};
use opspace_backend::signal_names::{
    DQ, DQ_DESIRED, LEAST_DISTANCE, MOTOR_TORQUE, Q, Q_DESIRED, SERVO_CHANNEL, TORQUE_DESIRED,
};
use opspace_backend::{CommandKind, Setpoints};
use opspace_experiment::evaluate::metrics::run_log::{Control, Run};
use opspace_experiment::evaluate::metrics::times::CycleTimes;
use opspace_experiment::evaluate::spectrum::Welch;
use opspace_experiment::extensions::Entry;
use opspace_experiment::run::experiment::Experiment;
use opspace_log::Recording;
use realfft::RealFftPlanner;
use std::fmt;
use std::sync::Arc;

/// Duration of a block of the spectrum of a torque error, s.
const ERROR_BLOCK_S: f64 = 1.0;

/// Kind of figures over time of a run.
#[derive(Clone)]
pub struct FigureKind {
    /// Name of the kind.
    pub name: &'static str,
    draw: Draw,
}

type Added = dyn Fn(&Experiment, &Recording) -> Vec<Figure> + Send + Sync;

#[derive(Clone)]
enum Draw {
    BuiltIn(fn(&Run<'_>) -> Vec<Figure>),
    Added(Arc<Added>),
}

/// The built-in kinds, in the order of their figures: what the run is about, then the joints.
static BUILT_IN: [FigureKind; 6] = [
    FigureKind::built_in("tasks", task_figures),
    FigureKind::built_in("energy", |run| energy_figure(run).into_iter().collect()),
    FigureKind::built_in("distances", |run| distance_figure(run).into_iter().collect()),
    FigureKind::built_in("torques", |run| torques(run).into_iter().collect()),
    FigureKind::built_in("setpoints", |run| setpoint_figure(run).into_iter().collect()),
    FigureKind::built_in("slack", |run| slack_figure(run).into_iter().collect()),
];

impl FigureKind {
    /// Creates a kind whose figures `draw` draws of each segment of a log. All segments must have the same figures, panels and
    /// lines, which are joined.
    #[must_use]
    pub fn new(
        name: &'static str,
        draw: impl Fn(&Experiment, &Recording) -> Vec<Figure> + Send + Sync + 'static,
    ) -> Self {
        Self { name, draw: Draw::Added(Arc::new(draw)) }
    }

    const fn built_in(name: &'static str, draw: fn(&Run<'_>) -> Vec<Figure>) -> Self {
        Self { name, draw: Draw::BuiltIn(draw) }
    }

    fn draw(&self, run: &Run<'_>) -> Vec<Figure> {
        match &self.draw {
            Draw::BuiltIn(draw) => draw(run),
            Draw::Added(draw) => draw(run.experiment, run.recording),
        }
    }
}

impl Entry for FigureKind {
    const KIND: &'static str = "kind of figures";

    fn built_in() -> &'static [Self] {
        &BUILT_IN
    }

    fn name(&self) -> &str {
        self.name
    }
}

impl fmt::Debug for FigureKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

/// Drawings of a run.
#[derive(Default)]
pub(crate) struct RunDrawings {
    pub(crate) figures: Vec<Figure>,
    /// Links at several moments.
    pub(crate) arm: Option<CollisionMoment>,
    /// Collision geometry; empty without one.
    pub(crate) collisions: Vec<CollisionMoment>,
    /// Moving picture.
    pub(crate) pictures: Option<RunPictures>,
}

/// Figures of a run while segments of its log arrive: the response to pushes, the tasks, then torques and setpoints by joint.
pub(crate) struct RunFigures<'a> {
    experiment: &'a Experiment,
    control: Control,
    responses: ResponseFigures<'a>,
    paths: PathFigures<'a>,
    /// Figures over time.
    figures: Vec<Figure>,
    /// Joint, axis label and spectrum of the torque error of each joint, at servo rate, after settling.
    errors: Vec<(String, String, Welch)>,
    times: CycleTimes,
    events: EventTimes<'a>,
    collisions: CollisionMoments<'a>,
    pictures: PictureRows<'a>,
}

impl<'a> RunFigures<'a> {
    pub(crate) fn new(experiment: &'a Experiment) -> Self {
        Self {
            experiment,
            control: Control::default(),
            responses: ResponseFigures::new(experiment),
            paths: PathFigures::new(experiment),
            figures: Vec::new(),
            errors: Vec::new(),
            times: CycleTimes::default(),
            events: EventTimes::new(experiment),
            collisions: CollisionMoments::new(experiment),
            pictures: PictureRows::new(experiment),
        }
    }

    /// Adds the next segment of the log.
    pub(crate) fn add(&mut self, segment: &Recording, is_last: bool) {
        self.times.add(segment);
        let Some(run) = Run::new(self.experiment, segment, &mut self.control, is_last) else { return };
        let kinds = self.experiment.task().tables.all::<FigureKind>();
        let next: Vec<Figure> = kinds.flat_map(|kind| kind.draw(&run)).collect();
        append(&mut self.figures, next);
        self.events.add(&run);
        self.responses.add(&run);
        self.paths.add(&run);
        self.collisions.add(&run);
        self.pictures.add(&run);
        self.add_torque_errors(&run);
    }

    /// Adds the torque errors of a segment; there are none without a true motor torque.
    fn add_torque_errors(&mut self, run: &Run<'_>) {
        let Some(servo) = run.recording.channel(SERVO_CHANNEL) else { return };
        let (Some(motor), Some(desired)) = (servo.signal(MOTOR_TORQUE), servo.signal(TORQUE_DESIRED)) else {
            return;
        };
        if self.errors.is_empty() {
            let mut planner = RealFftPlanner::new();
            let block = (ERROR_BLOCK_S * run.experiment.profile().1.servo_hz.get()).round() as usize;
            let joints = motor.elements().iter().enumerate();
            self.errors = joints
                .map(|(j, joint)| {
                    (joint.clone(), label_of("amplitude", &motor, j), Welch::new(block, &mut planner))
                })
                .collect();
        }
        for k in run.settled(&servo.time_s) {
            let errors = motor.row(k).iter().zip(desired.row(k)).map(|(motor, desired)| motor - desired);
            self.errors.iter_mut().zip(errors).for_each(|((.., spectrum), error)| spectrum.add(error));
        }
    }

    /// Returns the figures, the arm, the collision geometry and the moving picture; none if the log has no control cycle.
    pub(crate) fn finish(self) -> RunDrawings {
        if self.control.start_s.is_none() {
            return RunDrawings::default();
        }
        let mut over_time = complete(&self.events.finish(), self.figures);
        // A task that presses is about its force.
        let is_about_force = over_time.first().is_some_and(|first| first.title.starts_with(FORCE));
        let forces = if is_about_force { vec![over_time.remove(0)] } else { Vec::new() };
        let mut figures = self.responses.finish();
        figures.extend(forces.into_iter().chain(self.paths.finish()).chain(over_time));
        figures.extend(torque_error_spectrum(self.experiment, self.errors));
        figures.extend(computing_times(&self.times));
        let (arm, collisions) = self.collisions.finish();
        RunDrawings { figures, arm, collisions, pictures: self.pictures.finish() }
    }
}

/// True if servos hold each setpoint for more than one of their periods.
fn holds_setpoints(experiment: &Experiment) -> bool {
    let is_held = experiment.robot().file.interface.setpoints == Setpoints::Held;
    let commands_setpoints = experiment.options().backend != CommandKind::Torque;
    is_held && commands_setpoints && experiment.profile().1.servo_ticks_per_cycle.get() > 1
}

/// True if position servos hold each setpoint for more than one of their periods.
fn holds_positions(experiment: &Experiment) -> bool {
    holds_setpoints(experiment) && experiment.options().backend == CommandKind::Position
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
        let series = lines.into_iter().filter_map(|(label, style, column)| {
            Some(element(run, label, &channel.time_s, &column?, j, style))
        });
        let limit = limits.get(j).copied().unwrap_or(f64::INFINITY);
        Panel {
            limits: Some(-limit..limit),
            ..time_panel(joint, &label_of("torque", &motor, j), series.collect())
        }
    };
    Some(Figure {
        title: "Desired and motor torque".to_owned(),
        caption: if holds_positions(run.experiment) {
            format!("{caption} The motor torque ripples between two setpoints, while a joint moves.")
        } else {
            caption.to_owned()
        },
        panels: motor.elements().iter().enumerate().map(panel).collect(),
        overlays: true,
        ..Figure::default()
    })
}

/// Figure of the smallest distance that the controller keeps.
fn distance_figure(run: &Run<'_>) -> Option<Figure> {
    let distance = run.tick.signal(LEAST_DISTANCE)?;
    let limits = &run.experiment.kept_distances()?.limits;
    let series = element(run, "distance", &run.tick.time_s, &distance, 0, Style::Solid);
    let panel = Panel {
        limits: Some(limits.margin_m..f64::INFINITY),
        ..time_panel("closest pair", &label_of("distance", &distance, 0), vec![series])
    };
    Some(Figure {
        title: "Distance from collisions".to_owned(),
        caption: "Smallest distance of all pairs of links, and of links and obstacles, that are kept apart."
            .to_owned(),
        panels: vec![panel],
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
            (&velocities, "setpoint"),
        );
    }
    let positions = run.tick.signal(Q_DESIRED)?;
    let caption = "Position setpoints (commands of the position servos), and measured positions.";
    joint_figure(run, "Setpoints", caption, "position", (run.tick, Q, "measured"), (&positions, "setpoint"))
}

/// Figure of the spectra of the torque errors: where motor torque and desired torque differ.
fn torque_error_spectrum(experiment: &Experiment, errors: Vec<(String, String, Welch)>) -> Option<Figure> {
    let profile = experiment.profile().1;
    let panel = |(title, y_label, spectrum): (String, String, Welch)| {
        let spectrum = spectrum.finish()?;
        let line_hz = profile.servo_hz.get() / spectrum.n as f64;
        let amplitudes: Vec<f64> = spectrum.amplitudes().collect();
        let frequencies = (1..=amplitudes.len()).map(|line| line as f64 * line_hz).collect();
        let mut panel = Panel {
            title,
            x_label: "frequency (Hz)".to_owned(),
            y_label,
            series: vec![Series::new("motor minus desired torque", frequencies, amplitudes).thinned(COLUMNS)],
            x_scale: Scale::Log,
            y_scale: Scale::Log,
            ..Panel::default()
        };
        if profile.servo_ticks_per_cycle.get() > 1 {
            panel.marks.push((1.0 / profile.period_s(), "interface rate".to_owned()));
        }
        Some(panel)
    };
    let panels: Vec<Panel> = errors.into_iter().filter_map(panel).collect();
    let settle_s = experiment.task().file.settle_s.get();
    let cause = if holds_setpoints(experiment) {
        " Setpoints that are held while a joint moves give lines at multiples of the interface rate; friction, noise and \
         model errors make up the rest."
    } else {
        ""
    };
    (!panels.is_empty()).then(|| Figure {
        title: "Spectrum of the torque error".to_owned(),
        caption: format!(
            "Motor torque minus desired torque: amplitude by frequency after settle_s ({settle_s} s), rms over blocks of \
             one second (Hann window, Welch).{cause}"
        ),
        panels,
        ..Figure::default()
    })
}

/// Histogram of the durations of the control cycles.
fn computing_times(times: &CycleTimes) -> Option<Figure> {
    const BINS: usize = 60;
    let times_ns = times.histogram()?;
    let (least, largest) = (times_ns.min_nz() as f64, times_ns.max() as f64);
    if largest <= 0.0 {
        return None;
    }
    // Bins of equal ratio: a few cycles take a hundred times longer than the others.
    let ratio = (largest / least).max(1.1).powf(1.0 / BINS as f64);
    let mut counts = [0_u64; BINS];
    for counted in times_ns.iter_recorded().filter(|counted| counted.value_iterated_to() > 0) {
        let bin = ((counted.value_iterated_to() as f64 / least).ln() / ratio.ln()) as usize;
        counts[bin.min(BINS - 1)] += counted.count_at_value();
    }
    let (mut x, mut y) = (Vec::new(), Vec::new());
    for (bin, count) in counts.into_iter().enumerate() {
        // Steps; an empty bin interrupts the line, as a logarithmic axis has no zero.
        x.extend([0, 1].map(|end| 1e-3 * least * ratio.powi((bin + end) as i32)));
        y.extend([if count > 0 { count as f64 } else { f64::NAN }; 2]);
    }
    let at = |share: f64| 1e-3 * times_ns.value_at_quantile(share) as f64;
    let panel = Panel {
        x_label: "duration of a control cycle (µs)".to_owned(),
        y_label: "cycles".to_owned(),
        series: vec![Series::new("cycles", x, y)],
        marks: vec![(at(0.5), "median".to_owned()), (at(0.99), "99 % took less".to_owned())],
        x_scale: Scale::Log,
        y_scale: Scale::Log,
        ..Panel::default()
    };
    Some(Figure {
        title: "Computing time".to_owned(),
        caption: "Number of control cycles of the whole run by duration: estimator, model, controller and transformer, without communication. \
                  Measured on the computer of this run, among its other work."
            .to_owned(),
        panels: vec![panel],
        ..Figure::default()
    })
}
