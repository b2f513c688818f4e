//! Metrics of a coupling between two robots, computed from the logs of both.

use crate::evaluate::harmonics::{Harmonics, fit};
use crate::evaluate::metrics::run_log::{Control, RmsMax, Run};
use crate::metrics::coupling_metrics::{CouplingMetrics, FeltLine};
use crate::run::couplings::Coupling;
use crate::run::experiment::Experiment;
use crate::run::scenario::Scenario;
use nalgebra::{Matrix3, Vector3};
use opspace_backend::signal_names::{
    self, DISPLACEMENT, FORCE, PACKETS_LOST, PASSIVITY_TIME, PORT_CLOSED, PORT_ENERGY_IN, PORT_ENERGY_OUT,
    PORT_FORCE, PORT_POSITION, POSITION, REFERENCE, TRUTH_CHANNEL, WORK,
};
use opspace_control::{AxesFrame, ControlledFrame, TaskParameters, orientation};
use opspace_coupling::CoupledParameters;
use opspace_log::{Column, Recording};
use opspace_loop::high_pass::HighPass;
use opspace_model::FrameId;
use opspace_sim::{EnvironmentObjectParameters, HeldObjectParameters, OperatorMotion, ProbeMotion};
use std::f64::consts::{PI, TAU};

/// Frequencies between which the felt stiffness is summarised, Hz: above, the inertia of arm and hand dominates.
pub const FELT_HZ: [f64; 2] = [0.5, 2.0];

/// Frequency above which the motion of a hand is neither the operator's nor his tremor, Hz.
const FAST_HZ: f64 = 20.0;

/// Time over which the rms of the fast velocity is taken, and the drift is averaged, s.
const WINDOW_S: [f64; 2] = [0.25, 0.5];

/// Force below which nothing touches, N.
const TOUCH_N: f64 = 0.1;

/// Motion and forces of one robot, at each row of its true state.
pub struct Track<'a> {
    experiment: &'a Experiment,
    control: Control,
    frame: Option<(FrameId, Matrix3<f64>)>,
    task: &'a str,
    parameters: Option<&'a CoupledParameters>,
    home: Option<Vector3<f64>>,
    /// Times since the start of control, s.
    pub time_s: Vec<f64>,
    /// True position of the frame in the world, m.
    position: Vec<Vector3<f64>>,
    /// Force of the first operator on the frame, in the world, N.
    pub(crate) operator: Vec<Vector3<f64>>,
    /// Largest force of a surface, N.
    pub(crate) touch_n: Vec<f64>,
    /// Work of the environment on the robot, J.
    pub(crate) work_j: Vec<f64>,
    /// Displacement of the carried object since the start of control, m, and force of its grip on the frame, N, in the world;
    /// none without an object.
    object: Option<String>,
    pub(crate) object_rows: Vec<[Vector3<f64>; 2]>,
    object_home: Option<Vector3<f64>>,
    /// Signals of the coupled task.
    pub ticks: Ticks,
}

/// Signals of the coupled task, at each cycle.
#[derive(Default)]
pub struct Ticks {
    /// Name and unit of each row.
    rows: Vec<(String, String)>,
    /// Times of the cycles after the start of control, s.
    pub time_s: Vec<f64>,
    /// Position that is sent, by rows.
    pub sent: Vec<Vec<f64>>,
    /// Displacement and reference, by rows.
    displacement: Vec<Vec<f64>>,
    reference: Vec<Vec<f64>>,
    pub(crate) closed: Vec<bool>,
    /// Force that is sent, by rows.
    pub force: Vec<Vec<f64>>,
    /// Energy that has entered and left the coupling, J.
    pub energy_j: Vec<[f64; 2]>,
    /// Packets lost so far.
    pub packets_lost: Vec<f64>,
    /// Time for which the passivity control was active so far, s.
    pub passivity_s: Vec<f64>,
}

/// Metrics of a coupling while segments of both logs arrive.
pub struct CouplingEvaluator<'a> {
    /// Coupling of the scenario.
    pub coupling: &'a Coupling,
    members: [usize; 2],
    /// Leader and follower.
    pub tracks: [Track<'a>; 2],
    settle_s: f64,
}

impl<'a> Track<'a> {
    fn new(experiment: &'a Experiment, task: &'a str, object: Option<String>) -> Self {
        let parameters = match experiment.task().file.task.get(task) {
            Some(TaskParameters::Registered(task)) => task.parameters::<CoupledParameters>(),
            _ => None,
        };
        let frame = parameters.and_then(|p| {
            let frame = experiment.robot().model.frame_id(p.frame.as_ref()?).ok()?;
            Some((frame, orientation::from_rpy(p.axes_rpy_rad)))
        });
        Self {
            experiment,
            control: Control::default(),
            frame,
            task,
            parameters,
            home: None,
            time_s: Vec::new(),
            position: Vec::new(),
            operator: Vec::new(),
            touch_n: Vec::new(),
            work_j: Vec::new(),
            object,
            object_rows: Vec::new(),
            object_home: None,
            ticks: Ticks::default(),
        }
    }

    fn add(&mut self, recording: &Recording, is_last: bool) {
        let Some(run) = Run::new(self.experiment, recording, &mut self.control, is_last) else { return };
        self.add_ticks(&run);
        let Some(truth) = recording.channel(TRUTH_CHANNEL) else { return };
        let Some((frame, _)) = self.frame else { return };
        let environment = &self.experiment.task().file.environment;
        let operator = environment.iter().find_map(|(name, object)| {
            matches!(object, EnvironmentObjectParameters::Spring(_)).then_some(name)
        });
        let operator = operator.and_then(|name| truth.signal(&signal_names::of(name, FORCE)));
        let surfaces: Vec<_> = environment
            .iter()
            .filter(|(_, object)| !matches!(object, EnvironmentObjectParameters::Spring(_)))
            .filter_map(|(name, _)| truth.signal(&signal_names::of(name, FORCE)))
            .collect();
        let works: Vec<_> =
            environment.keys().filter_map(|name| truth.signal(&signal_names::of(name, WORK))).collect();
        let object_rows = self.object.as_ref().and_then(|object| {
            let frame = self.parameters?.frame.as_ref()?;
            let force = truth.signal(&signal_names::of(object, &format!("{frame}.{FORCE}")))?;
            Some((truth.signal(&signal_names::of(object, POSITION))?, force))
        });
        let world = AxesFrame::Fixed(Matrix3::identity());
        for (k, pose, _) in run.poses(ControlledFrame::Frame(frame), |_| world) {
            self.time_s.push(truth.time_s[k] - run.start_s);
            self.home.get_or_insert(pose.translation);
            self.position.push(pose.translation);
            let vector = |row: &[f64]| Vector3::new(row[0], row[1], row[2]);
            self.operator.push(operator.map_or_else(Vector3::zeros, |force| vector(force.row(k))));
            self.touch_n.push(surfaces.iter().map(|force| vector(force.row(k)).norm()).fold(0.0, f64::max));
            if let Some((position, force)) = &object_rows {
                let position = vector(position.row(k));
                let home = *self.object_home.get_or_insert(position);
                self.object_rows.push([position - home, vector(force.row(k))]);
            }
            self.work_j.push(works.iter().map(|work| work.row(k)[0]).sum());
        }
    }

    fn add_ticks(&mut self, run: &Run<'_>) {
        let signal = |quantity| run.tick.signal(&signal_names::of(self.task, quantity));
        let (Some(sent), Some(displacement), Some(closed), Some(force)) =
            (signal(PORT_POSITION), signal(DISPLACEMENT), signal(PORT_CLOSED), signal(PORT_FORCE))
        else {
            return;
        };
        let (Some(reference), Some(lost)) = (signal(REFERENCE), signal(PACKETS_LOST)) else { return };
        let [energy_in, energy_out, passivity] =
            [PORT_ENERGY_IN, PORT_ENERGY_OUT, PASSIVITY_TIME].map(signal);
        let value = |column: &Option<Column<'_>>, k: usize| column.map_or(0.0, |column| column.row(k)[0]);
        let ticks = &mut self.ticks;
        ticks.rows = sent.elements().iter().cloned().zip(sent.units().iter().cloned()).collect();
        for k in (0..run.tick.len()).filter(|&k| {
            run.tick.time_s[k] >= run.start_s - run.same_s && run.tick.time_s[k] <= run.to_s + run.same_s
        }) {
            ticks.time_s.push(run.tick.time_s[k] - run.start_s);
            ticks.sent.push(sent.row(k).to_vec());
            ticks.displacement.push(displacement.row(k).to_vec());
            ticks.reference.push(reference.row(k).to_vec());
            ticks.closed.push(closed.row(k)[0] == 1.0);
            ticks.force.push(force.row(k).to_vec());
            ticks.energy_j.push([value(&energy_in, k), value(&energy_out, k)]);
            ticks.packets_lost.push(lost.row(k)[0]);
            ticks.passivity_s.push(value(&passivity, k));
        }
    }

    /// Index of the last cycle at `time_s` or before.
    fn tick_at(&self, time_s: f64) -> Option<usize> {
        let half_s = 0.25 * self.experiment.profile().1.period_s();
        self.ticks.time_s.partition_point(|&t| t <= time_s + half_s).checked_sub(1)
    }

    /// Index of the last row of the true state at `time_s` or before.
    fn row_at(&self, time_s: f64) -> Option<usize> {
        let half_s = 0.25 * self.experiment.profile().1.period_s();
        self.time_s.partition_point(|&t| t <= time_s + half_s).checked_sub(1)
    }

    /// True position in the leader's coordinates at a time, by rows: that which is sent, with the error of the measured
    /// displacement taken off. `scale` is that of positions, 1 for the leader.
    fn port_position(&self, time_s: f64, scale: f64) -> Option<Vec<f64>> {
        let tick = self.tick_at(time_s)?;
        let mut position = self.ticks.sent[tick].clone();
        let (Some((_, axes)), Some(home), Some(row)) = (self.frame, self.home, self.row_at(time_s)) else {
            return Some(position);
        };
        let Some(p) = self.parameters else { return Some(position) };
        let moved = axes.tr_mul(&(self.position[row] - home));
        let coupled =
            p.axes.as_ref().map_or_else(|| vec![0, 1, 2], |axes| axes.iter().map(|a| a.index()).collect());
        for (at, &axis) in coupled.iter().enumerate().filter(|(_, axis)| **axis < 3) {
            position[at] += (moved[axis] - self.ticks.displacement[tick][at]) / scale;
        }
        Some(position)
    }
}

impl<'a> CouplingEvaluator<'a> {
    pub(crate) fn new(scenario: &'a Scenario, coupling: &'a Coupling) -> Self {
        let track = |end: &'a (usize, String)| {
            let member = &scenario.members[end.0];
            let holds = |object: &HeldObjectParameters| object.grip.iter().any(|g| g.robot == member.name);
            let object = scenario.objects.iter().find(|(_, object)| holds(object));
            let object = object.filter(|_| coupling.file.carry.is_some()).map(|(name, _)| name.clone());
            Track::new(&member.experiment, &end.1, object)
        };
        Self {
            coupling,
            members: [coupling.leader.0, coupling.follower.0],
            tracks: [track(&coupling.leader), track(&coupling.follower)],
            settle_s: scenario.settle_s,
        }
    }

    /// Adds the next segment of the log of a robot.
    pub(crate) fn add(&mut self, member: usize, recording: &Recording, is_last: bool) {
        for (number, track) in self.members.iter().zip(&mut self.tracks) {
            if *number == member {
                track.add(recording, is_last);
            }
        }
    }

    pub(crate) fn finish(&self) -> CouplingMetrics {
        let [leader, follower] = &self.tracks;
        let sum_of_last = |values: fn(&Ticks) -> &Vec<f64>| {
            Some(values(&leader.ticks).last()? + values(&follower.ticks).last()?)
        };
        let mut metrics = CouplingMetrics {
            energy_extracted_j: self.energy_extracted_j(),
            fast_velocity_m_per_s: self
                .tracks
                .iter()
                .filter_map(|t| t.fast_velocity(self.held_s()))
                .reduce(f64::max),
            passivity_time_s: sum_of_last(|ticks| &ticks.passivity_s),
            packets_lost: sum_of_last(|ticks| &ticks.packets_lost),
            ..CouplingMetrics::default()
        };
        self.add_tracking(&mut metrics);
        let mut force = RmsMax::default();
        let has_operator = self.probe().is_some() || leader.operator.iter().any(|f| *f != Vector3::zeros());
        for (_, f) in leader.time_s.iter().zip(&leader.operator).filter(|(t, _)| **t >= self.settle_s) {
            force.add(f.norm());
        }
        metrics.hand_force_rms_n = force.rms().filter(|_| has_operator);
        self.add_felt(&mut metrics);
        self.add_carried(&mut metrics);
        metrics
    }

    /// Path of a carried object, and internal force on it.
    fn add_carried(&self, metrics: &mut CouplingMetrics) {
        let (Some(law), [leader, follower]) = (&self.coupling.file.carry, &self.tracks) else { return };
        let Some((_, axes)) = leader.frame else { return };
        let wanted = axes * Vector3::from(law.direction).normalize() * law.internal_force_n.unwrap_or(0.0);
        let (mut path, mut force) = (RmsMax::default(), RmsMax::default());
        for (row, [moved, on_leader]) in leader.object_rows.iter().enumerate() {
            let time_s = leader.time_s[row];
            let (Some(tick), Some(other)) = (leader.tick_at(time_s), follower.row_at(time_s)) else {
                continue;
            };
            let Some([_, on_follower]) = follower.object_rows.get(other).filter(|_| time_s >= self.settle_s)
            else {
                continue;
            };
            let reference = Vector3::from_column_slice(&leader.ticks.reference[tick]);
            path.add((moved - axes * reference).norm());
            force.add(((on_follower - on_leader) * 0.5 - wanted).norm());
        }
        (metrics.path_rms_m, metrics.path_max_m) = (path.rms(), path.max());
        (metrics.internal_force_rms_n, metrics.internal_force_max_n) = (force.rms(), force.max());
    }

    fn add_tracking(&self, metrics: &mut CouplingMetrics) {
        let [leader, follower] = &self.tracks;
        let scale = self.coupling.teleoperation().map_or(1.0, |law| law.scale.position.get());
        let end_s = leader.ticks.time_s.last().copied().unwrap_or(0.0);
        let (mut distance, mut drift) = (RmsMax::default(), RmsMax::default());
        for (k, &time_s) in leader.ticks.time_s.iter().enumerate() {
            let Some(at) = follower.tick_at(time_s) else { continue };
            let is_closed = leader.ticks.closed[k] && follower.ticks.closed[at];
            let ports = leader.port_position(time_s, 1.0).zip(follower.port_position(time_s, scale));
            let Some((a, b)) = ports.filter(|_| is_closed) else { continue };
            let apart = a.iter().zip(&b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
            let touches = follower.row_at(time_s).is_some_and(|row| follower.touch_n[row] > TOUCH_N);
            if time_s >= self.settle_s && !touches {
                distance.add(apart);
            }
            if time_s >= end_s - WINDOW_S[1] {
                drift.add(apart);
            }
        }
        metrics.tracking_rms_m = distance.rms();
        metrics.tracking_max_m = distance.max();
        metrics.drift_m = drift.rms();
    }

    /// Work of the environment on both robots, at a row of the leader, J.
    pub fn work_at(&self, row: usize) -> f64 {
        let [leader, follower] = &self.tracks;
        let of_follower = follower.row_at(leader.time_s[row]).map_or(0.0, |row| follower.work_j[row]);
        leader.work_j[row] + of_follower
    }

    /// Largest energy that operator and environment have received from the pair.
    fn energy_extracted_j(&self) -> Option<f64> {
        let rows = 0..self.tracks[0].time_s.len();
        rows.map(|row| -self.work_at(row)).reduce(f64::max).map(|most| most.max(0.0))
    }

    /// Name and unit of each row of the coupling; none before the first segment.
    pub fn rows(&self) -> Vec<(String, String)> {
        self.tracks[0].ticks.rows.clone()
    }

    /// Probe of the leader's operator.
    fn probe(&self) -> Option<&'a ProbeMotion> {
        self.tracks[0].experiment.task().file.environment.values().find_map(|object| match object {
            EnvironmentObjectParameters::Spring(spring) => match &spring.motion {
                OperatorMotion::Scripted(motion) => motion.probe.as_ref(),
                _ => None,
            },
            _ => None,
        })
    }

    /// Time in which the operator probes, or from `settle_s` on if he does not, s after the start of control.
    fn held_s(&self) -> [f64; 2] {
        match self.probe().filter(|probe| probe.rms_m.get() > 0.0) {
            None => [self.settle_s, f64::INFINITY],
            Some(probe) => [
                probe.from_s.get() + probe.ramp_s.get(),
                probe.until_s.map_or(f64::INFINITY, |until| until.get() - probe.ramp_s.get()),
            ],
        }
    }

    /// Stiffness of the follower's first wall, N/m.
    fn wall_n_per_m(&self) -> Option<f64> {
        self.tracks[1].experiment.task().file.environment.values().find_map(|object| match object {
            EnvironmentObjectParameters::Wall(wall) => Some(wall.stiffness_n_per_m.get()),
            _ => None,
        })
    }

    fn add_felt(&self, metrics: &mut CouplingMetrics) {
        let Some(probe) = self.probe().filter(|probe| probe.rms_m.get() > 0.0) else { return };
        let [leader, follower] = &self.tracks;
        let [from_s, until_s] = self.held_s();
        let probed = |t: &f64| *t >= from_s && *t <= until_s;
        let axis = Vector3::from(probe.axis).normalize();
        let rows: Vec<usize> = (0..leader.time_s.len()).filter(|&k| probed(&leader.time_s[k])).collect();
        let series = |value: &dyn Fn(usize) -> f64| -> Vec<(f64, f64)> {
            rows.iter().map(|&k| (leader.time_s[k], value(k))).collect()
        };
        let lines: Vec<f64> = probe.lines_hz.iter().map(|line| line.get()).collect();
        let force = fit(&series(&|k| leader.operator[k].dot(&axis)), &lines);
        let motion = fit(&series(&|k| leader.position[k].dot(&axis)), &lines);
        let (Some(force), Some(motion)) = (force, motion) else { return };
        metrics.felt = felt(&lines, &force, &motion);
        let summarised =
            metrics.felt.iter().filter(|line| (FELT_HZ[0]..=FELT_HZ[1]).contains(&line.frequency_hz));
        let stiffness: Vec<f64> = summarised.map(|line| line.stiffness_n_per_m).collect();
        metrics.felt_least_n_per_m = stiffness.iter().copied().reduce(f64::min);
        metrics.felt_largest_n_per_m = stiffness.iter().copied().reduce(f64::max);
        if let (Some(law), Some(wall)) = (self.coupling.teleoperation(), self.wall_n_per_m()) {
            let spring = law.stiffness_n_per_m.get();
            let scale = law.scale.force.get() * law.scale.position.get();
            let in_series = scale * spring * wall / (spring + wall);
            metrics.felt_over_series_least = metrics.felt_least_n_per_m.map(|felt| felt / in_series);
            metrics.felt_over_series_largest = metrics.felt_largest_n_per_m.map(|felt| felt / in_series);
            let mut lost_s = 0.0;
            for k in 1..follower.time_s.len() {
                if probed(&follower.time_s[k]) && follower.touch_n[k] < TOUCH_N {
                    lost_s += follower.time_s[k] - follower.time_s[k - 1];
                }
            }
            metrics.contact_lost_s = Some(lost_s);
        }
    }
}

impl Track<'_> {
    /// Largest rms over a window of the velocity above 20 Hz, m/s.
    fn fast_velocity(&self, [from_s, until_s]: [f64; 2]) -> Option<f64> {
        let period_s = self.experiment.profile().1.period_s();
        let high_pass = HighPass::new(FAST_HZ, period_s)?;
        let mut filters = [high_pass.clone(), high_pass.clone(), high_pass];
        let window = ((WINDOW_S[0] / period_s).round() as usize).max(1);
        let (mut squares, mut sum, mut most) = (Vec::new(), 0.0, None::<f64>);
        for k in 1..self.position.len() {
            let velocity = (self.position[k] - self.position[k - 1]) / period_s;
            let fast = Vector3::from_fn(|i, _| filters[i].update(velocity[i]));
            let square = fast.norm_squared();
            squares.push(square);
            sum += square;
            if squares.len() > window {
                sum -= squares[squares.len() - 1 - window];
            }
            if (from_s..=until_s).contains(&self.time_s[k]) && squares.len() >= window {
                let rms = (sum.max(0.0) / window as f64).sqrt();
                most = Some(most.map_or(rms, |most| most.max(rms)));
            }
        }
        most
    }
}

/// Amplitude and phase of the felt stiffness at each line.
fn felt(lines: &[f64], force: &[Harmonics], motion: &[Harmonics]) -> Vec<FeltLine> {
    let lines = lines.iter().zip(force).zip(motion);
    lines
        .map(|((&frequency_hz, force), motion)| {
            let phase = force.phase_rad() - motion.phase_rad();
            FeltLine {
                frequency_hz,
                stiffness_n_per_m: force.amplitude() / motion.amplitude(),
                phase_rad: (phase + PI).rem_euclid(TAU) - PI,
            }
        })
        .collect()
}
