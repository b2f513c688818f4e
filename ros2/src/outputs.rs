//! Outputs of a run: poses, references, errors, wrenches, frames and diagnostics, published in the thread that writes the log.

use crate::config::{InterfaceConfig, NodePlace, profile};
use crate::frames::{WORLD, pose};
use crate::interface::{TargetCounts, ros_name, task_topic};
use crate::messages::{
    DiagnosticArray, DiagnosticStatus, Float64MultiArray, Header, KeyValue, MultiArrayLayout, PoseStamped,
    Stamp, TfMessage, Transform, TransformStamped, Twist, TwistStamped, Wrench, WrenchStamped,
};
use crate::node::{Participants, RosNode};
use crate::pace::Pace;
use opspace_backend::signal_names::{
    ERROR, FAULT, MISSED_CYCLES, ORIENTATION, PHASE, POSITION, REFERENCE, REFERENCE_ORIENTATION,
    RESPONSE_TIME, SAMPLE_INTERVAL, STATUS, TICK_CHANNEL, TIMING_CHANNEL, VELOCITY, WRENCH,
};
use opspace_backend::{DriverError, ForceSensor, Layout};
use opspace_log::{ViewerReceiver, ViewerTopic};
use opspace_loop::{LateCommands, Phase};
use ros2_client::Publisher;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// Time between two diagnostics, s.
const DIAGNOSTICS_S: f64 = 1.0;

/// Names of the phases by their codes.
const PHASES: [&str; 6] = ["rest", "control", "stopped", "held", "resuming", "stopping"];

/// Description of a robot and its task, for the outputs.
pub struct OutputPlan {
    /// Place of the node.
    pub place: NodePlace,
    /// Options.
    pub config: InterfaceConfig,
    /// Names of the Cartesian tasks.
    pub tasks: Vec<String>,
    /// Force sensors.
    pub sensors: Vec<ForceSensor>,
    /// Name of the base.
    pub base: String,
    /// Name of the robot.
    pub robot: String,
    /// Period of a cycle, s.
    pub period_s: f64,
    /// Counts of targets.
    pub counts: Arc<TargetCounts>,
}

/// Publishers of the outputs of a robot.
pub struct Outputs {
    plan: OutputPlan,
    // The node lives as long as its topics.
    _node: RosNode,
    tasks: Vec<TaskOutput>,
    sensors: Vec<SensorOutput>,
    frames: Publisher<TfMessage>,
    diagnostics: Publisher<DiagnosticArray>,
    tick: Option<usize>,
    timing: Option<usize>,
    columns: Columns,
    pace: Pace,
    response: Pace,
    late: LateCommands,
    last_s: f64,
    last_diagnostics_s: f64,
}

struct TaskOutput {
    name: String,
    state: Publisher<PoseStamped>,
    velocity: Publisher<TwistStamped>,
    reference: Publisher<PoseStamped>,
    error: Publisher<Float64MultiArray>,
    columns: TaskColumns,
}

#[derive(Clone, Debug, Default)]
struct TaskColumns {
    position: Option<Range<usize>>,
    orientation: Option<Range<usize>>,
    velocity: Option<Range<usize>>,
    reference: Option<Range<usize>>,
    reference_orientation: Option<Range<usize>>,
    error: Option<Range<usize>>,
}

struct SensorOutput {
    name: String,
    wrench: Publisher<WrenchStamped>,
    columns: Option<Range<usize>>,
}

#[derive(Clone, Debug, Default)]
struct Columns {
    phase: Option<Range<usize>>,
    fault: Option<Range<usize>>,
    missed: Option<Range<usize>>,
    status: Option<Range<usize>>,
}

impl Outputs {
    /// Creates the node of the outputs.
    ///
    /// # Errors
    /// A node or a topic that cannot be created.
    pub fn open(participants: &Participants, plan: OutputPlan) -> Result<Self, DriverError> {
        let mut node = participants.node(&plan.place, "_outputs")?;
        let quality = profile(true, 1);
        let mut tasks = Vec::new();
        for name in &plan.tasks {
            let topic = |topic: &str| task_topic(&plan.place, name, topic);
            tasks.push(TaskOutput {
                name: name.clone(),
                state: node.publisher(&topic("state"), &quality)?,
                velocity: node.publisher(&topic("velocity"), &quality)?,
                reference: node.publisher(&topic("reference"), &quality)?,
                error: node.publisher(&topic("error"), &quality)?,
                columns: TaskColumns::default(),
            });
        }
        let mut sensors = Vec::new();
        for sensor in &plan.sensors {
            let topic = format!("{}/{}/wrench", plan.place.node, ros_name(&sensor.name));
            sensors.push(SensorOutput {
                name: sensor.name.clone(),
                wrench: node.publisher(&topic, &quality)?,
                columns: None,
            });
        }
        let frames = node.publisher("/tf", &profile(true, 100))?;
        let diagnostics = node.publisher("/diagnostics", &profile(true, 10))?;
        let pace = Pace::new(plan.period_s);
        let late = LateCommands::new(plan.period_s);
        Ok(Self {
            plan,
            _node: node,
            tasks,
            sensors,
            frames,
            diagnostics,
            tick: None,
            timing: None,
            columns: Columns::default(),
            response: pace.clone(),
            pace,
            late,
            last_s: f64::NEG_INFINITY,
            last_diagnostics_s: f64::NEG_INFINITY,
        })
    }

    /// Publishes a row. A client of DDS that does not take a message loses it: the next one follows soon.
    fn publish(&self, row: &[f64]) {
        let stamp = Stamp::now();
        let header = |frame: &str| Header { stamp, frame_id: frame.to_owned() };
        let values = |columns: &Option<Range<usize>>| columns.clone().and_then(|range| row.get(range));
        let mut transforms = Vec::new();
        for TaskOutput { name, state, velocity, reference, error, columns } in &self.tasks {
            if let (Some(position), Some(orientation)) =
                (values(&columns.position), values(&columns.orientation))
            {
                let pose = pose(position, orientation);
                let _ = state.publish(PoseStamped { header: header(WORLD), pose });
                transforms.push(TransformStamped {
                    header: header(WORLD),
                    child_frame_id: format!("{}/{}", self.plan.place.node, ros_name(name)),
                    transform: Transform { translation: pose.position, rotation: pose.orientation },
                });
            }
            if let Some(&[a, b, c, d, e, f]) = values(&columns.velocity) {
                let twist = Twist { linear: [a, b, c].into(), angular: [d, e, f].into() };
                let _ = velocity.publish(TwistStamped { header: header(WORLD), twist });
            }
            if let (Some(position), Some(orientation)) =
                (values(&columns.reference), values(&columns.reference_orientation))
            {
                let pose = pose(position, orientation);
                let _ = reference.publish(PoseStamped { header: header(WORLD), pose });
                transforms.push(TransformStamped {
                    header: header(WORLD),
                    child_frame_id: format!("{}/{}_reference", self.plan.place.node, ros_name(name)),
                    transform: Transform { translation: pose.position, rotation: pose.orientation },
                });
            }
            if let Some(values) = values(&columns.error) {
                let message =
                    Float64MultiArray { layout: MultiArrayLayout::default(), data: values.to_vec() };
                let _ = error.publish(message);
            }
        }
        for SensorOutput { wrench, columns, .. } in &self.sensors {
            if let Some(&[a, b, c, d, e, f]) = values(columns) {
                let values = Wrench { force: [a, b, c].into(), torque: [d, e, f].into() };
                let _ = wrench.publish(WrenchStamped { header: header(WORLD), wrench: values });
            }
        }
        if !transforms.is_empty() {
            let _ = self.frames.publish(TfMessage { transforms });
        }
    }

    fn publish_diagnostics(&self, row: &[f64]) {
        let value = |columns: &Option<Range<usize>>| columns.clone().map_or(0.0, |range| row[range.start]);
        let (phase, fault) = (value(&self.columns.phase), value(&self.columns.fault));
        let name = PHASES.get(phase as usize).copied().unwrap_or("unknown");
        let level = if fault != 0.0 { 2 } else { u8::from(name == "held") };
        let ms = |seconds: f64| format!("{:.3}", 1e3 * seconds);
        let counts = &self.plan.counts;
        let values = [
            ("phase", name.to_owned()),
            ("fault", format!("{fault}")),
            ("missed_cycles", format!("{}", value(&self.columns.missed))),
            ("period_stated_ms", ms(self.plan.period_s)),
            ("period_mean_ms", ms(self.pace.mean_s())),
            ("period_99_percent_ms", ms(self.pace.quantile_s(0.99))),
            ("period_longest_ms", ms(self.pace.longest_s())),
            ("response_mean_ms", ms(self.response.mean_s())),
            ("response_99_percent_ms", ms(self.response.quantile_s(0.99))),
            ("response_longest_ms", ms(self.response.longest_s())),
            ("late_commands", self.late.count().to_string()),
            ("longest_lateness_ms", ms(self.late.longest_s())),
            ("targets_accepted", counts.accepted.load(Ordering::Relaxed).to_string()),
            ("targets_refused", counts.refused.load(Ordering::Relaxed).to_string()),
            ("last_refusal", counts.last_refusal()),
        ];
        let values = values.map(|(key, value)| KeyValue { key: key.to_owned(), value });
        let status = DiagnosticStatus {
            level,
            name: format!("opspace: {}", self.plan.robot),
            message: name.to_owned(),
            hardware_id: self.plan.robot.clone(),
            values: values.to_vec(),
        };
        let header = Header { stamp: Stamp::now(), frame_id: String::new() };
        let _ = self.diagnostics.publish(DiagnosticArray { header, status: vec![status] });
    }
}

impl ViewerReceiver for Outputs {
    fn begin(&mut self, _topics: &[ViewerTopic], rows: &[&Layout]) {
        self.tick = rows.iter().position(|layout| layout.channel == TICK_CHANNEL);
        // Of the channel `timing`, the rows of this version have these columns.
        let has_times = |layout: &Layout| {
            layout.channel == TIMING_CHANNEL
                && layout.columns(SAMPLE_INTERVAL) == Some(1..2)
                && layout.columns(RESPONSE_TIME) == Some(2..3)
        };
        self.timing = rows.iter().position(|layout| has_times(layout));
        let Some(layout) = self.tick.map(|tick| rows[tick]) else { return };
        let find = |name: &str| {
            let mut at = 0;
            for signal in &layout.signals {
                let range = at..at + signal.len();
                if signal.name == name {
                    return Some(range);
                }
                at = range.end;
            }
            None
        };
        self.columns = Columns {
            phase: find(PHASE),
            fault: find(FAULT),
            missed: find(MISSED_CYCLES),
            status: find(STATUS),
        };
        for task in &mut self.tasks {
            let of_task = |signal: &str| find(&format!("{}.{signal}", task.name));
            task.columns = TaskColumns {
                position: of_task(POSITION),
                orientation: of_task(ORIENTATION),
                velocity: of_task(VELOCITY),
                reference: of_task(REFERENCE),
                reference_orientation: of_task(REFERENCE_ORIENTATION),
                error: of_task(ERROR),
            };
        }
        for sensor in &mut self.sensors {
            sensor.columns = find(&format!("{}.{WRENCH}", sensor.name));
        }
    }

    fn message(&mut self, _topic: usize, _log_time_ns: u64, _data: &[u8]) {}

    fn row(&mut self, channel: usize, time_s: f64, row: &[f64]) {
        if let (true, &[_, interval_ns, response_ns]) = (self.timing == Some(channel), row) {
            self.response.add(1e-9 * response_ns);
            self.late.add(1e-9 * interval_ns, 1e-9 * response_ns);
        }
        if self.tick != Some(channel) {
            return;
        }
        if let Some(status) = &self.columns.status {
            self.pace.add(1e-6 * row[status.start]);
        }
        // Before control the tasks have no values.
        let is_controlled =
            self.columns.phase.as_ref().is_some_and(|phase| row[phase.start] != Phase::Rest.code());
        if is_controlled
            && time_s - self.last_s >= 1.0 / self.plan.config.output_hz - 0.5 * self.plan.period_s
        {
            self.last_s = time_s;
            self.publish(row);
        }
        if time_s - self.last_diagnostics_s >= DIAGNOSTICS_S {
            self.last_diagnostics_s = time_s;
            self.publish_diagnostics(row);
        }
    }
}
