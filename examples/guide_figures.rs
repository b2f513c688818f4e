//! Figures of the guide: axis modes, kinds of tasks, references, tuning, and the tasks of the cookbook.
//!
//! `cargo run --release -p opspace --example guide_figures -- [FOLDER]` draws them in `runs/guide_figures`, or in FOLDER; the
//! guide shows the copies in `docs/figures`.

#[path = "common/curves.rs"]
mod curves;
#[path = "common/plot.rs"]
mod plot;

use curves::{curve, tick};
use opspace::backend::{Backend, Sample};
use opspace::control::CartesianTarget;
use opspace::experiment::{Experiment, Files, Progress};
use opspace::log::Recording;
use plot::{BLUE, GREEN, Line, ORANGE, Panel, draw};
use plotters::style::RGBColor;
use std::error::Error;

type Outcome<T> = Result<T, Box<dyn Error>>;

const VIOLET: RGBColor = RGBColor(150, 80, 160);

/// Cycles between two points of a line.
const STEP: usize = 25;

fn main() -> Outcome<()> {
    let folder = std::env::args().nth(1).unwrap_or("runs/guide_figures".to_owned());
    std::fs::create_dir_all(&folder)?;
    let path = |name: &str| format!("{folder}/{name}.svg");
    draw(&path("axis-modes"), 1, &axis_modes()?)?;
    draw(&path("task-kinds"), 2, &task_kinds()?)?;
    draw(&path("references"), 2, &references()?)?;
    draw(&path("tuning"), 1, &tuning()?)?;
    draw(&path("transformer-for-pid"), 1, &transformer()?)?;
    for (name, panels) in cookbook()? {
        draw(&path(&format!("cookbook-{name}")), 1, &panels)?;
    }
    Ok(())
}

/// Log of a run.
struct Log {
    recording: Recording,
    /// Range of time that is shown, from the start of control, s.
    begin_s: f64,
    end_s: f64,
}

impl Log {
    /// Runs a task of `tasks/` with settings.
    fn of(task: &str, settings: &[&str]) -> Outcome<Self> {
        let settings: Vec<String> = settings.iter().map(|&setting| setting.to_owned()).collect();
        let path = format!("tasks/{task}.toml");
        let experiment = Experiment::load(Files::Disk, path.as_ref(), None, Default::default(), &settings)?;
        Self::from(&experiment.run(std::io::Cursor::new(Vec::new()), &Progress::default())?.sink.into_inner())
    }

    fn from(bytes: &[u8]) -> Outcome<Self> {
        let recording = Recording::from_bytes(bytes)?;
        let tick = recording.tick()?;
        let phase = tick.signal("phase").ok_or("no phase")?;
        let begin = phase.rows().position(|row| row[0] > 0.0).ok_or("control never began")?;
        let (begin_s, end_s) = (tick.time_s[begin], *tick.time_s.last().ok_or("no rows")?);
        Ok(Self { recording, begin_s, end_s })
    }

    /// Element of a signal over the time since the start of control, relative to an origin and scaled.
    fn line(&self, signal: (&str, usize), scaled: (f64, f64)) -> Outcome<Vec<(f64, f64)>> {
        let shown = self.begin_s..self.end_s + 1e-6;
        let points = curve(tick(&self.recording)?, (&shown, STEP), signal, scaled)?;
        Ok(points.into_iter().map(|(t, value)| (t - self.begin_s, value)).collect())
    }

    /// Displacement of an element from its first value, scaled.
    fn moved(&self, signal: (&str, usize), scale: f64) -> Outcome<Vec<(f64, f64)>> {
        let points = self.line(signal, (0.0, scale))?;
        let first = first_of(&points);
        Ok(points.into_iter().map(|(t, value)| (t, value - first)).collect())
    }

    /// A displacement of an element of another signal from the same origin.
    fn moved_from(&self, signal: (&str, usize), from: (&str, usize), scale: f64) -> Outcome<Vec<(f64, f64)>> {
        let first = first_of(&self.line(from, (0.0, scale))?);
        Ok(self.line(signal, (0.0, scale))?.into_iter().map(|(t, value)| (t, value - first)).collect())
    }

    /// Length of the first `n` elements of a signal, scaled.
    fn norm(&self, signal: &str, elements: std::ops::Range<usize>, scale: f64) -> Outcome<Vec<(f64, f64)>> {
        let lines = elements
            .map(|element| self.line((signal, element), (0.0, scale)))
            .collect::<Outcome<Vec<_>>>()?;
        let length = |k: usize| lines.iter().map(|line| line[k].1.powi(2)).sum::<f64>().sqrt();
        Ok(lines[0].iter().enumerate().map(|(k, point)| (point.0, length(k))).collect())
    }

    /// Two elements of a signal against each other, scaled.
    fn shape(&self, (signal, x, y): (&str, usize, usize), scale: f64) -> Outcome<Vec<(f64, f64)>> {
        let (x, y) = (self.line((signal, x), (0.0, scale))?, self.line((signal, y), (0.0, scale))?);
        Ok(x.into_iter().zip(y).map(|(x, y)| (x.1, y.1)).collect())
    }

    /// Reference and motion of an element of a Cartesian task, mm.
    fn followed(&self, task: &str, axis: usize) -> Outcome<Vec<Line>> {
        let (reference, position) = (format!("{task}.reference"), format!("{task}.position"));
        Ok(vec![
            Line::new("motion", ORANGE, 8, self.moved_from((&position, axis), (&reference, axis), 1e3)?),
            Line::new("reference", BLUE, 4, self.moved((&reference, axis), 1e3)?),
        ])
    }

    /// Force and target of an element of a force task, N.
    fn pressed(&self, task: &str, axis: usize) -> Outcome<Vec<Line>> {
        let line = |signal| self.line((&format!("{task}.{signal}"), axis), (0.0, 1.0));
        Ok(vec![
            Line::new("sensed", ORANGE, 6, line("sensed_force")?),
            Line::new("target", BLUE, 4, line("target_force")?),
        ])
    }
}

/// First value of a line that is known.
fn first_of(points: &[(f64, f64)]) -> f64 {
    points.iter().map(|point| point.1).find(|value| value.is_finite()).unwrap_or_default()
}

/// Panel of two lengths against each other, mm.
fn plan(title: &str, x_label: &str, y_label: &str, lines: Vec<Line>) -> Panel {
    Panel { x_label: x_label.to_owned(), ..Panel::over_time(title, y_label, lines) }
}

/// Settings of `panda-reach`: the flange holds its pose for four seconds.
const HELD: &str = "task.flange.cartesian.reference=hold";
const PUSH: &str = "environment={ someone = { pushes = { frame = \"flange\", push = [{ at_s = 1.0, duration_s = 1.0, force_n = [10.0, 0.0, 0.0] }] } } }";

fn axis_modes() -> Outcome<Vec<Panel>> {
    let pushed = |settings: &[&str]| {
        Log::of("panda-reach", &[&[HELD, PUSH], settings].concat())?.moved(("flange.position", 0), 1e3)
    };
    let impedance = "task.flange.cartesian.impedance={ stiffness_n_per_m = 400.0, stiffness_nm_per_rad = 30.0, damping_ratio = 0.7 }";
    let compliant =
        ["task.flange.cartesian.axes.x=compliant", "task.flange.cartesian.compliant_damping_per_s=4"];
    let lines = vec![
        Line::new("compliant", ORANGE, 6, pushed(&compliant)?),
        Line::new("free, with a posture below", VIOLET, 6, pushed(&["task.flange.cartesian.axes.x=free"])?),
        Line::new(
            "motion, 400 N/m",
            GREEN,
            6,
            Log::of("cookbook/hold-against-pushes", &[PUSH, impedance, "duration_s=4.0", "expect={}"])?
                .moved(("flange.position", 0), 1e3)?,
        ),
        Line::new("motion, 20 rad/s", BLUE, 6, pushed(&[])?),
    ];
    let force = Log::of("panda-press", &["duration_s=5.0"])?;
    let lines_of_force = vec![
        Line::new(
            "estimated from motor current",
            ORANGE,
            6,
            force.line(("flange.sensed_force", 2), (0.0, 1.0))?,
        ),
        Line::new("target", BLUE, 4, force.line(("flange.target_force", 2), (0.0, 1.0))?),
    ];
    Ok(vec![
        Panel::over_time("Axis x, pushed with 10 N from 1 to 2 s", "displacement (mm)", lines),
        Panel::over_time("Force axis z: on a table, along a circle", "force (N)", lines_of_force),
    ])
}

fn task_kinds() -> Outcome<Vec<Panel>> {
    let levels = Log::of("panda-levels", &["duration_s=4.0"])?;
    let swivel = Log::of("panda-swivel", &["duration_s=5.0", "expect={}"])?;
    let pushed = |rest: &str| {
        let rest = format!("task={{ rest = {rest} }}");
        let settings = ["priority=[\"rest\"]", &rest, PUSH];
        Log::of("panda-reach", &settings)?.moved(("q", 1), 1e3)
    };
    let joint = |signal: &str, of: &str| levels.moved_from((signal, 0), (of, 0), 1e3);
    let value = |signal: &str| swivel.moved_from((signal, 0), ("elbow.reference", 0), 1e3);
    Ok(vec![
        Panel::over_time(
            "cartesian: y of the flange",
            "mm",
            Log::of("panda-reach", &[])?.followed("flange", 1)?,
        ),
        Panel::over_time("center-of-mass: x", "mm", levels.followed("balance", 0)?),
        Panel::over_time(
            "swivel: angle of the elbow",
            "mrad",
            vec![
                Line::new("motion", ORANGE, 8, value("elbow.value")?),
                Line::new("reference", BLUE, 4, value("elbow.reference")?),
            ],
        ),
        Panel::over_time(
            "joint-tracking: joint 1",
            "mrad",
            vec![
                Line::new("motion", ORANGE, 8, joint("q", "turn.reference")?),
                Line::new("reference", BLUE, 4, joint("turn.reference", "turn.reference")?),
            ],
        ),
        Panel::over_time(
            "joint-posture: joint 2, pushed at the flange",
            "mrad",
            vec![Line::new(
                "motion",
                ORANGE,
                6,
                pushed("{ joint-posture = { frequency_rad_per_s = 6.0, damping_ratio = 1.0 } }")?,
            )],
        ),
        Panel::over_time(
            "joint-damping: the same push",
            "mrad",
            vec![Line::new(
                "motion",
                ORANGE,
                6,
                pushed("{ joint-damping = { damping_nms_per_rad = 5.0 } }")?,
            )],
        ),
    ])
}

fn references() -> Outcome<Vec<Panel>> {
    let flange = |reference: &str| {
        let reference = format!("task.flange.cartesian.reference={reference}");
        Log::of("panda-reach", &[&reference])?.followed("flange", 1)
    };
    let path = Log::of("follow-path", &["duration_s=4.0", "expect={}"])?;
    let recorded = Log::of("ur5e-recorded", &["expect={}"])?;
    let shapes = |log: &Log, task: &str, (x, y): (usize, usize)| -> Outcome<Vec<Line>> {
        Ok(vec![
            Line::new("motion", ORANGE, 8, log.shape((&format!("{task}.position"), x, y), 1e3)?),
            Line::new("reference", BLUE, 4, log.shape((&format!("{task}.reference"), x, y), 1e3)?),
        ])
    };
    Ok(vec![
        Panel::over_time(
            "point-to-point",
            "y (mm)",
            flange("{ point-to-point = { position = { offset_m = [0.0, 0.1, 0.0] }, duration_s = 1.0 } }")?,
        ),
        Panel::over_time("waypoints", "y (mm)", Log::of("panda-reach", &[])?.followed("flange", 1)?),
        Panel::over_time(
            "goal, which changes at 0.8 s",
            "x (mm)",
            Log::of("panda-goals", &["duration_s=2.4"])?.followed("flange", 0)?,
        ),
        Panel::over_time(
            "sinusoid",
            "y (mm)",
            flange("{ sinusoid = { ramp_s = 1.0, y = [{ amplitude_m = 0.05, frequency_hz = 0.5 }] } }")?,
        ),
        plan("path: lines and an arc, rounded corners", "y (mm)", "z (mm)", shapes(&path, "hand", (1, 2))?),
        plan("recorded", "x (mm)", "y (mm)", shapes(&recorded, "flange", (0, 1))?),
        Panel::over_time(
            "streamed, without targets from 1.5 to 2.5 s",
            "y (mm)",
            streamed()?.followed("hand", 1)?,
        ),
        Panel::over_time(
            "hold, pushed with 10 N at 1 s",
            "x (mm)",
            Log::of("panda-reach", &[HELD, PUSH])?.followed("flange", 0)?,
        ),
    ])
}

/// Streams a sine of 5 cm along y at 100 Hz, with a pause.
fn streamed() -> Outcome<Log> {
    let experiment = Experiment::load(
        Files::Disk,
        "examples/tasks/streamed.toml".as_ref(),
        None,
        Default::default(),
        &[],
    )?;
    let mut arm = experiment.simulated_arm()?;
    let capabilities = arm.capabilities().clone();
    let mut sample = Sample::new(&capabilities);
    let result = experiment.run_with(
        &capabilities,
        None,
        std::io::Cursor::new(Vec::new()),
        &Progress::default(),
        |run| {
            let mut target = CartesianTarget::of(run.targets(), "hand").expect("a streamed reference");
            for cycle in 0_u32.. {
                if run.is_over() || arm.read(&mut sample).is_err() {
                    break;
                }
                let t = sample.time_s;
                if cycle % 10 == 0 && !(1.5..2.5).contains(&t) {
                    let (sin, cos) = (2.0 * t).sin_cos();
                    target.position([0.3646, -0.0389 + 0.05 * sin, -0.1571]).expect("finite");
                    target.twist([0.0, 0.1 * cos, 0.0, 0.0, 0.0, 0.0]).expect("finite");
                    run.targets().write(target.task(), t, &target.inputs()).expect("inputs of the task");
                }
                if let Some(command) = run.cycle(&sample) {
                    arm.write(command).expect("the arm accepts it");
                }
            }
            arm.stop();
        },
    )?;
    Log::from(&result.sink.into_inner())
}

fn tuning() -> Outcome<Vec<Panel>> {
    let error = |frequency: u32, gain: f64| {
        let settings = [
            format!("task.flange.cartesian.gains.frequency_rad_per_s={frequency}"),
            format!("friction_compensation.gain={gain:?}"),
        ];
        Log::of("panda-reach", &settings.each_ref().map(String::as_str))?.norm("flange.error", 0..3, 1e3)
    };
    Ok(vec![
        Panel::over_time(
            "Position error at three frequencies, without friction compensation",
            "mm",
            vec![
                Line::new("5 rad/s", ORANGE, 6, error(5, 0.0)?),
                Line::new("10 rad/s", GREEN, 6, error(10, 0.0)?),
                Line::new("20 rad/s", BLUE, 6, error(20, 0.0)?),
            ],
        ),
        Panel::over_time(
            "Position error at 10 rad/s",
            "mm",
            vec![
                Line::new("no friction compensation", GREEN, 6, error(10, 0.0)?),
                Line::new("gain = 0.8", BLUE, 6, error(10, 0.8)?),
            ],
        ),
    ])
}

fn transformer() -> Outcome<Vec<Panel>> {
    let log = Log::of("compliant-x", &["duration_s=6.0"])?;
    let elbow = 3;
    let (setpoint, q) = (log.line(("q_desired", elbow), (0.0, 1e3))?, log.line(("q", elbow), (0.0, 1e3))?);
    let ahead = setpoint.iter().zip(&q).map(|(a, b)| (a.0, a.1 - b.1)).collect();
    let torque = |signal| log.line((signal, elbow), (0.0, 1.0));
    Ok(vec![
        Panel::over_time(
            "Elbow: setpoint minus position",
            "mrad",
            vec![Line::new("setpoint − position", GREEN, 5, ahead)],
        ),
        Panel::over_time(
            "Elbow: torque",
            "Nm",
            vec![
                Line::new("motor torque", ORANGE, 8, torque("motor_torque")?),
                Line::new("desired torque", BLUE, 4, torque("torque_desired")?),
            ],
        ),
    ])
}

/// Figures of the cookbook, by name.
fn cookbook() -> Outcome<Vec<(&'static str, Vec<Panel>)>> {
    let draw = Log::of("draw-letter", &[])?;
    let wipe = Log::of("wipe-table", &[])?;
    let press = Log::of("cookbook/press", &[])?;
    let guide = Log::of("cookbook/hand-guide", &[])?;
    let level = Log::of("cookbook/carry-level", &[])?;
    let recorded = Log::of("ur5e-recorded", &[])?;
    let (teach, repeat) = (Log::of("cookbook/teach", &[])?, Log::of("cookbook/repeat", &[])?);
    let hold = Log::of("cookbook/hold-against-pushes", &[])?;
    let elbow = Log::of("panda-swivel", &[])?;
    let approach = Log::of("cookbook/approach-retract", &[])?;
    let shape = |log: &Log, signal: (&str, usize, usize)| -> Outcome<Vec<Line>> {
        Ok(vec![Line::new("motion", ORANGE, 6, log.shape(signal, 1e3)?)])
    };
    let axes = |log: &Log, task: &str| -> Outcome<Vec<Line>> {
        let position = format!("{task}.position");
        let moved = |axis| log.moved((&position, axis), 1e3);
        Ok(vec![
            Line::new("x", ORANGE, 5, moved(0)?),
            Line::new("y", BLUE, 5, moved(1)?),
            Line::new("z", GREEN, 5, moved(2)?),
        ])
    };
    let height = |task: &str, color| -> Outcome<Line> {
        let position = format!("{task}.position");
        Ok(Line::new(task, color, 6, approach.line((&position, 2), (0.0, 1e3))?))
    };
    Ok(vec![
        (
            "draw",
            vec![
                plan(
                    "The pen on the paper, from above",
                    "y (mm)",
                    "x (mm)",
                    shape(&draw, ("draw.position", 1, 0))?,
                ),
                Panel::over_time("Force on the paper", "force (N)", draw.pressed("draw", 2)?),
            ],
        ),
        (
            "wipe",
            vec![
                plan(
                    "The hand on the table, from above",
                    "y (mm)",
                    "x (mm)",
                    shape(&wipe, ("hand.position", 1, 0))?,
                ),
                Panel::over_time("Force on the table", "force (N)", wipe.pressed("hand", 2)?),
            ],
        ),
        ("press", vec![Panel::over_time("Force on the table", "force (N)", press.pressed("hand", 2)?)]),
        (
            "hand-guide",
            vec![
                Panel::over_time("Displacement of the guided flange", "mm", axes(&guide, "flange")?),
                Panel::over_time(
                    "Least distance of the links from the table and from each other",
                    "mm",
                    vec![Line::new(
                        "least distance",
                        ORANGE,
                        6,
                        guide.line(("least_distance", 0), (0.0, 1e3))?,
                    )],
                ),
            ],
        ),
        (
            "carry-level",
            vec![
                Panel::over_time("Displacement of the flange", "mm", axes(&level, "flange")?),
                Panel::over_time(
                    "Tilt",
                    "mrad",
                    vec![Line::new("tilt", ORANGE, 6, level.norm("level.error", 3..5, 1e3)?)],
                ),
            ],
        ),
        (
            "recorded",
            vec![plan(
                "The flange, from above",
                "x (mm)",
                "y (mm)",
                vec![
                    Line::new("motion", ORANGE, 8, recorded.shape(("flange.position", 0, 1), 1e3)?),
                    Line::new("recorded path", BLUE, 4, recorded.shape(("flange.reference", 0, 1), 1e3)?),
                ],
            )],
        ),
        (
            "teach",
            vec![
                Panel::over_time("Taught by an operator", "mm", axes(&teach, "hand")?),
                Panel::over_time("Repeated", "mm", axes(&repeat, "hand")?),
            ],
        ),
        (
            "hold",
            vec![Panel::over_time("Displacement of the flange, pushed twice", "mm", axes(&hold, "flange")?)],
        ),
        (
            "elbow",
            vec![
                Panel::over_time(
                    "Angle of the elbow",
                    "mrad",
                    vec![Line::new("swivel angle", ORANGE, 6, elbow.moved(("elbow.value", 0), 1e3)?)],
                ),
                Panel::over_time(
                    "Position error of the flange",
                    "mm",
                    vec![Line::new("error", BLUE, 6, elbow.norm("flange.error", 0..3, 1e3)?)],
                ),
            ],
        ),
        (
            "approach",
            vec![
                Panel::over_time(
                    "Height of the hand",
                    "z (mm)",
                    vec![height("move", BLUE)?, height("touch", ORANGE)?],
                ),
                Panel::over_time("Force on the part", "force (N)", approach.pressed("touch", 2)?),
            ],
        ),
    ])
}
