//! Execution of an experiment, with its log.

use crate::run::error::RunError;
use crate::run::experiment::Experiment;
use opspace_backend::{Backend, Capabilities, GroundTruth, Layout, SERVO, Sink, TruthLayouts, World};
use opspace_log::{
    Channel, LogError, LoggedTargets, OutcomeRecord, Pace, Recorder, Recording, ReplayBackend,
    ReplayedCommands, ViewerReceiver, WriteStats, Writer, record_with,
};
use opspace_loop::{
    ControlLoop, Fault, RealTime, RealTimeMode, RealTimeParameters, Run, RunOutcome, drive, drive_with,
};
use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Progress and stop requests of a run, shared with other threads.
#[derive(Debug, Default)]
pub struct Progress {
    /// Stop request: set to stop the run safely.
    pub interrupt: Arc<AtomicBool>,
    /// Second stop request, for a stop that takes too long: set to end the run at once by the robots' own stops.
    pub abort: Arc<AtomicBool>,
    /// Number of interface cycles so far.
    pub ticks: Arc<AtomicU64>,
    /// Number of scenarios whose robots are being driven.
    driven: AtomicUsize,
    /// Scheduling of the thread that drives real robots, once it does.
    real_time: Arc<Mutex<Option<String>>>,
}

impl Progress {
    /// True while robots are driven: from the first read to the last stop.
    #[must_use]
    pub fn is_driving(&self) -> bool {
        self.driven.load(Ordering::Acquire) > 0
    }

    /// Calls `body`, in which real robots are driven, with the real-time scheduling that is asked for; without, as
    /// [`driving`](Self::driving).
    ///
    /// # Errors
    /// If the scheduling is required, and the machine does not allow it.
    pub(crate) fn driving_in_real_time<T>(
        &self,
        parameters: Option<RealTimeParameters>,
        body: impl FnOnce() -> T,
    ) -> Result<T, RunError> {
        let Some(parameters) = parameters else { return Ok(self.driving(body)) };
        let real_time = RealTime::enter(parameters);
        check_real_time(parameters, &real_time)?;
        *lock(&self.real_time) = Some(real_time.text());
        Ok(self.driving(body))
    }

    /// Calls `body`, in which robots are driven.
    pub(crate) fn driving<T>(&self, body: impl FnOnce() -> T) -> T {
        struct Driving<'a>(&'a AtomicUsize);
        impl Drop for Driving<'_> {
            fn drop(&mut self) {
                self.0.fetch_sub(1, Ordering::AcqRel);
            }
        }
        self.driven.fetch_add(1, Ordering::AcqRel);
        let _driving = Driving(&self.driven);
        body()
    }
}

/// Refuses a machine that does not allow what is required.
pub(crate) fn check_real_time(parameters: RealTimeParameters, real_time: &RealTime) -> Result<(), RunError> {
    if parameters.mode == RealTimeMode::Required && !real_time.is_complete() {
        return Err(RunError::NotRealTime { words: real_time.text() });
    }
    Ok(())
}

/// Locks a value, whatever became of another thread.
fn lock<T>(value: &Mutex<T>) -> MutexGuard<'_, T> {
    value.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Result of a finished run.
#[non_exhaustive]
pub struct RunResult<W> {
    /// Outcome of the run.
    pub outcome: RunOutcome,
    /// Outcome of the run as text, as in the log.
    pub record: OutcomeRecord,
    /// Numbers of rows written and rows lost.
    pub written: WriteStats,
    /// The log.
    pub sink: W,
    /// Ratio of robot time to wall-clock time.
    pub realtime_factor: f64,
}

/// State of a log in progress that its closer shares.
struct Shared<W> {
    /// Writer, until the log is closed.
    writer: Mutex<Option<Writer<W>>>,
    cycles: AtomicU64,
    /// Number of rows, once the log has all of them.
    rows: AtomicU64,
    began: Instant,
    /// Scheduling of the thread that drives a real robot; of a simulated one, `None`.
    real_time: Option<Arc<Mutex<Option<String>>>>,
}

/// Closes the log of a run once the run, which may own the log, is gone; or from another thread, if the run cannot end.
pub struct LogCloser<W>(Arc<Shared<W>>);

impl<W> LogCloser<W> {
    /// Writes the outcome of a run of `experiment` to the log and closes it. Drop the run and its log before.
    ///
    /// # Errors
    /// If the log cannot be written, or is closed already.
    pub fn close(self, experiment: &Experiment, outcome: RunOutcome) -> Result<RunResult<W>, RunError> {
        let record = experiment.outcome_record(&outcome);
        self.close_with(experiment, outcome, record)
    }

    /// Closes the log of a run that does not end, with this description of its outcome.
    ///
    /// # Errors
    /// As [`close`](Self::close).
    pub fn abandon(&self, record: OutcomeRecord) -> Result<(), RunError> {
        self.writer()?.finish_with(self.with_scheduling(record)).map(|_written| ()).map_err(RunError::from)
    }

    /// Returns the record with the scheduling of the thread that drove the robot.
    pub fn with_scheduling(&self, record: OutcomeRecord) -> OutcomeRecord {
        let real_time = self.0.real_time.as_ref().and_then(|real_time| lock(real_time).clone());
        OutcomeRecord { real_time, ..record }
    }

    /// Closes the log with `record`, which describes `outcome`.
    fn close_with(
        self,
        experiment: &Experiment,
        outcome: RunOutcome,
        record: OutcomeRecord,
    ) -> Result<RunResult<W>, RunError> {
        let record = self.with_scheduling(record);
        let robot_s = self.0.cycles.load(Ordering::Relaxed) as f64 * experiment.profile().1.period_s();
        let realtime_factor = robot_s / self.0.began.elapsed().as_secs_f64();
        match self.writer()?.finish_with(record.clone()) {
            Ok((written, sink)) => Ok(RunResult { outcome, record, written, sink, realtime_factor }),
            Err(source) => {
                let rows = self.0.rows.load(Ordering::Relaxed);
                Err(RunError::LogCutShort { record: Box::new(record), rows, source })
            }
        }
    }

    /// Takes the writer of an open log.
    fn writer(&self) -> Result<Writer<W>, RunError> {
        let taken = self.0.writer.lock().ok().and_then(|mut writer| writer.take());
        taken.ok_or_else(|| LogError::Write(io::Error::other("the log is already closed")).into())
    }
}

/// The log of a run in progress.
pub struct OpenLog<W> {
    recorder: Recorder,
    shared: Arc<Shared<W>>,
    progress: Arc<AtomicU64>,
    rows: u64,
}

impl<W: Send> Sink for OpenLog<W> {
    fn row(&mut self, channel: usize, time_s: f64, row: &[f64]) {
        self.rows += 1;
        self.recorder.push(channel, time_s, row);
    }

    fn between_ticks(&mut self) {
        self.shared.cycles.fetch_add(1, Ordering::Relaxed);
        self.progress.fetch_add(1, Ordering::Relaxed);
        self.recorder.wait_for_space();
    }
}

impl<W> Drop for OpenLog<W> {
    fn drop(&mut self) {
        self.shared.rows.store(self.rows, Ordering::Relaxed);
    }
}

impl<W> OpenLog<W> {
    /// Writes the outcome of a run of `experiment` to the log and closes the log.
    ///
    /// # Errors
    /// If the log cannot be written.
    pub fn close(self, experiment: &Experiment, outcome: RunOutcome) -> Result<RunResult<W>, RunError> {
        let closer = self.closer();
        drop(self);
        closer.close(experiment, outcome)
    }

    /// Returns what closes the log without it.
    #[must_use]
    pub fn closer(&self) -> LogCloser<W> {
        LogCloser(Arc::clone(&self.shared))
    }
}

impl Experiment {
    /// Runs the experiment in simulation and writes its log to `sink`.
    ///
    /// # Errors
    /// A robot that cannot be simulated; a log that cannot be written.
    pub fn run<W: Write + Send + 'static>(
        &self,
        sink: W,
        progress: &Progress,
    ) -> Result<RunResult<W>, RunError> {
        self.run_on(&mut self.simulated_arm()?, sink, progress)
    }

    /// Runs the experiment on a robot. A real robot must be at the start position of the task
    /// ([`motion_to_start`](Self::motion_to_start)).
    ///
    /// # Errors
    /// A robot whose capabilities contradict robot.toml; a real robot that is not at the start position, or is
    /// selected together with an option that is only for comparisons; a log that cannot be written.
    pub fn run_on<W: Write + Send + 'static>(
        &self,
        backend: &mut dyn Backend,
        sink: W,
        progress: &Progress,
    ) -> Result<RunResult<W>, RunError> {
        self.check_robot(backend)?;
        let capabilities = backend.capabilities().clone();
        let truth = backend.ground_truth().map(GroundTruth::layouts);
        let real_time = self.real_time(&capabilities)?;
        let mut refused = Ok(());
        let result = self.run_with(&capabilities, truth, sink, progress, |run| {
            refused = progress.driving_in_real_time(real_time, || drive(backend, run));
        });
        refused.and(result)
    }

    /// Checks that a real robot is the one of robot.toml, and at the start position of the task.
    pub fn check_robot(&self, backend: &mut dyn Backend) -> Result<(), RunError> {
        if backend.capabilities().world == World::Real {
            self.compare_capabilities(backend.capabilities())?;
            self.check_start(backend)?;
        }
        Ok(())
    }

    /// Real-time scheduling for a robot with these capabilities; `None` if it is simulated, or has no driver: then it is the
    /// matter of the program that drives it.
    ///
    /// # Errors
    /// A wrong value in `[driver]`.
    pub(crate) fn real_time(
        &self,
        capabilities: &Capabilities,
    ) -> Result<Option<RealTimeParameters>, RunError> {
        match capabilities.world {
            World::Real if self.has_driver() => Ok(Some(self.robot().real_time()?)),
            _ => Ok(None),
        }
    }

    /// Drives a robot with the targets and stop requests of a log, and records to `sink`. The run ends with the log at the latest.
    pub(crate) fn drive_on_inputs(
        &self,
        robot: &mut dyn Backend,
        control: ControlLoop,
        sink: &mut dyn Sink,
        recording: &Recording,
        progress: &Progress,
    ) -> Result<RunOutcome, RunError> {
        let mut run = Run::new(control, self.duration_s(), sink)
            .with_stop_request(Arc::clone(&progress.interrupt))
            .with_abort_request(Arc::clone(&progress.abort));
        let targets = run.targets();
        let mut logged = LoggedTargets::new(recording, targets.layout(), targets.row())?;
        let mut before = |run: &mut Run<'_>| {
            let Some((row, stop_requested)) = logged.next_row() else { return false };
            run.targets().set_row(row);
            if stop_requested {
                progress.interrupt.store(true, Ordering::Relaxed);
            }
            true
        };
        progress.driving(|| drive_with(robot, &mut run, &mut before));
        Ok(run.finish())
    }

    /// Runs the experiment on a log in place of a robot: the control loop gets its samples, targets and stop requests.
    /// Targets that the log does not have keep their first values. The run ends with the log at the latest.
    ///
    /// # Errors
    /// A log without a quantity that robot.toml declares as measured; a log that cannot be written.
    pub fn run_on_log<W: Write + Send + 'static>(
        &self,
        recording: &Recording,
        sink: W,
        progress: &Progress,
    ) -> Result<RunResult<W>, RunError> {
        let mut robot = ReplayBackend::new(recording, self.capabilities().simulated())?;
        let (control, mut log) = self.open(&robot.capabilities().clone(), None, sink, progress)?;
        let outcome = self.drive_on_inputs(&mut robot, control, &mut log, recording, progress)?;
        let commands = robot.parted_s().map_or(ReplayedCommands::Equal, ReplayedCommands::PartAfter);
        let record = OutcomeRecord { replay: Some(commands), ..self.outcome_record(&outcome) };
        let closer = log.closer();
        drop(log);
        closer.close_with(self, outcome, record)
    }

    /// Runs the experiment with a loop of the caller: `body` calls [`Run::cycle`] once per interface cycle until
    /// [`Run::is_over`]. Use it for a robot that calls back, or to step several runs together. `truth` contains the
    /// layouts of the rows that a simulation logs.
    ///
    /// # Errors
    /// As [`run_on`](Self::run_on), but the start position is not checked.
    pub fn run_with<W: Write + Send + 'static>(
        &self,
        capabilities: &Capabilities,
        truth: Option<TruthLayouts>,
        sink: W,
        progress: &Progress,
        body: impl FnOnce(&mut Run<'_>),
    ) -> Result<RunResult<W>, RunError> {
        let (control, mut log) = self.open(capabilities, truth, sink, progress)?;
        let mut run = Run::new(control, self.duration_s(), &mut log)
            .with_stop_request(Arc::clone(&progress.interrupt))
            .with_abort_request(Arc::clone(&progress.abort));
        progress.driving(|| body(&mut run));
        let outcome = run.finish();
        log.close(self, outcome)
    }

    /// Returns the control loop of the experiment and its open log, for a run that the caller drives: create a
    /// [`Run`] of the loop with the log as its sink, then close the log with the outcome of the run.
    ///
    /// # Errors
    /// As [`run_on`](Self::run_on), but the start position is not checked.
    pub fn open<W: Write + Send + 'static>(
        &self,
        capabilities: &Capabilities,
        truth: Option<TruthLayouts>,
        sink: W,
        progress: &Progress,
    ) -> Result<(ControlLoop, OpenLog<W>), RunError> {
        self.open_with(capabilities, truth, sink, progress, Vec::new())
    }

    /// Returns control loop and log as [`open`](Self::open) does. `receivers` get the messages for viewers and the rows, in the thread
    /// that writes the log.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_with<W: Write + Send + 'static>(
        &self,
        capabilities: &Capabilities,
        truth: Option<TruthLayouts>,
        sink: W,
        progress: &Progress,
        receivers: Vec<Box<dyn ViewerReceiver>>,
    ) -> Result<(ControlLoop, OpenLog<W>), RunError> {
        let (control, channels) = self.prepare(capabilities, truth)?;
        let pace = match capabilities.world {
            World::Simulated => Pace::Simulated,
            World::Real => Pace::RealTime,
        };
        let header = self.header(capabilities.world);
        let (recorder, writer) = record_with(sink, header, channels, pace, receivers)?;
        let shared = Shared {
            writer: Mutex::new(Some(writer)),
            cycles: AtomicU64::new(0),
            rows: AtomicU64::new(0),
            began: Instant::now(),
            real_time: (capabilities.world == World::Real).then(|| Arc::clone(&progress.real_time)),
        };
        let progress = Arc::clone(&progress.ticks);
        Ok((control, OpenLog { recorder, shared: Arc::new(shared), progress, rows: 0 }))
    }

    /// Returns the control loop of the experiment and the layouts of its rows.
    pub(crate) fn loop_and_layouts(
        &self,
        capabilities: &Capabilities,
        truth: Option<TruthLayouts>,
    ) -> Result<(ControlLoop, Vec<Layout>), RunError> {
        let (control, channels) = self.prepare(capabilities, truth)?;
        Ok((control, channels.into_iter().map(|channel| channel.layout).collect()))
    }

    /// Returns the control loop of the experiment and the channels of its log.
    fn prepare(
        &self,
        capabilities: &Capabilities,
        truth: Option<TruthLayouts>,
    ) -> Result<(ControlLoop, Vec<Channel>), RunError> {
        if capabilities.world == World::Real {
            self.refuse_comparison_options()?;
        }
        self.compare_capabilities(capabilities)?;
        let control = self.control_loop_for(capabilities.reports_status)?;
        let profile = self.profile().1;
        let (cycle_hz, servo_hz) = (1.0 / profile.period_s(), profile.servo_hz.get());
        let channels = (Run::layouts(&control, truth).into_iter().enumerate())
            .map(|(channel, layout)| Channel {
                layout,
                rate_hz: if channel == SERVO { servo_hz } else { cycle_hz },
            })
            .collect();
        Ok((control, channels))
    }

    /// Describes the outcome of a run as text.
    #[must_use]
    pub fn outcome_record(&self, outcome: &RunOutcome) -> OutcomeRecord {
        match outcome {
            RunOutcome::Completed => OutcomeRecord::default(),
            RunOutcome::Interrupted { time_s } => {
                OutcomeRecord { interrupted: true, time_s: Some(*time_s), ..OutcomeRecord::default() }
            }
            RunOutcome::Faulted { fault, time_s } => OutcomeRecord {
                fault: Some(fault.describe(&self.robot().model)),
                interrupted: false,
                time_s: Some(*time_s),
                device_fault: match fault {
                    Fault::Device(fault) => Some(fault.clone()),
                    _ => None,
                },
                ..OutcomeRecord::default()
            },
        }
    }

    /// Number of interface cycles of a complete run, including the rest period before control starts.
    #[must_use]
    pub fn ticks(&self) -> u64 {
        let total_s = self.duration_s() + self.robot().file.safety.tare_s.get();
        (total_s / self.profile().1.period_s()).round() as u64
    }
}
