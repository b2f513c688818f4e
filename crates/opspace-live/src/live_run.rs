//! Companion of a run that a view shows: it paces the cycles, and applies the hand and the changes of a page as inputs of the run.

use crate::tunable::TaskInputs;
use crate::view::{LiveView, State, ViewedRobot};
use opspace_experiment::{Companion, Experiment, Scenario};
use opspace_log::ViewerReceiver;
use opspace_loop::{Pacer, Run};
use opspace_sim::{ExternalForce, ExternalForceHandle, SimulatedArm};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Companion of the run of a scenario.
pub struct LiveRun<'a> {
    view: &'a LiveView,
    pacer: Option<Pacer>,
    interrupt: Arc<AtomicBool>,
    /// Handles and forces of the robots that can be pushed. A real robot has none.
    handles: Vec<Option<ExternalForceHandle>>,
    forces: Vec<Option<ExternalForce>>,
    inputs: Vec<Option<TaskInputs>>,
    began: bool,
}

impl<'a> LiveRun<'a> {
    /// Shows a scenario in a view. `arms` are its simulated arms if it is only simulated, on which the hand acts; a run on real robots
    /// has none, and its view only watches. `interrupt` ends the run.
    pub fn new(
        view: &'a LiveView,
        scenario: &Scenario,
        arms: Option<&[SimulatedArm]>,
        interrupt: Arc<AtomicBool>,
    ) -> Self {
        let members = &scenario.members;
        let handle = |robot: usize| arms.and_then(|arms| arms.get(robot)?.external_force());
        let handles: Vec<_> = (0..members.len()).map(handle).collect();
        let robots = members.iter().zip(&handles).map(|(member, handle)| {
            let prefix = if members.len() > 1 { format!("/{}", member.name) } else { String::new() };
            viewed(&member.experiment, prefix, &member.name, handle.is_some())
        });
        view.show(robots.collect(), scenario.duration_s(), arms.is_some());
        // The clock of real robots is their own, and their inputs are not those of a page.
        let period_s = scenario.experiments().map(|experiment| experiment.profile().1.period_s());
        let pacer =
            arms.map(|_| Pacer::new(Arc::clone(&view.state.pace), period_s.fold(f64::INFINITY, f64::min)));
        let count = members.len();
        Self {
            view,
            pacer,
            interrupt,
            handles,
            forces: vec![None; count],
            inputs: (0..count).map(|_| None).collect(),
            began: false,
        }
    }

    /// Applies what pages ask for to the cycle of a robot.
    fn apply(&mut self, robot: usize, run: &mut Run<'_>) {
        let state = &self.view.state;
        if robot == 0 {
            state.set_time(run.control().clock_s());
            let forces = &mut self.forces;
            state.hand.apply(forces.len(), Instant::now(), &mut |robot, force| forces[robot] = force);
        }
        if let Some(handle) = &self.handles[robot]
            && handle.get() != self.forces[robot]
        {
            handle.set(self.forces[robot]);
        }
        if self.inputs[robot].is_none() {
            let mut tasks = state.tasks(robot);
            self.inputs[robot] = Some(TaskInputs::of(run, &mut tasks));
            state.set_tasks(robot, tasks);
        }
        let Self { inputs, .. } = self;
        if let Some(inputs) = &mut inputs[robot] {
            state.take_changes(robot, &mut |change| inputs.write(change, run));
        }
    }
}

/// Describes a robot of a run.
#[must_use]
pub fn viewed(experiment: &Experiment, prefix: String, name: &str, can_be_pushed: bool) -> ViewedRobot {
    let options = experiment.options();
    ViewedRobot {
        prefix,
        name: name.to_owned(),
        label: format!("{}, {}", options.backend.name(), options.controller.name()),
        base: experiment.robot().model.base(),
        is_compared: experiment.membership().is_none(),
        pushable: can_be_pushed.then(|| experiment.robot().model.clone()),
        tasks: crate::tunable::ViewedTask::all(experiment),
    }
}

impl Companion for LiveRun<'_> {
    fn receivers(&mut self, robot: usize) -> Vec<Box<dyn ViewerReceiver>> {
        self.view.receiver(robot).into_iter().collect()
    }

    fn before_cycle(&mut self, robot: usize, time_s: f64, run: &mut Run<'_>) -> bool {
        if !std::mem::replace(&mut self.began, true) {
            self.view.remove_other_channels();
        }
        let state: &State = &self.view.state;
        let Some(pacer) = &mut self.pacer else {
            state.set_time(run.control().clock_s());
            return true;
        };
        let interrupt = &self.interrupt;
        let mut is_over = || interrupt.load(Ordering::Relaxed) || state.wants_restart();
        if !pacer.wait(time_s, &mut is_over) && state.wants_restart() {
            return false;
        }
        self.apply(robot, run);
        true
    }
}
