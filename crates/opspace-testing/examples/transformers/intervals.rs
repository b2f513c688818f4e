//! Figure of what the hand feels over the width of the gains' interval, without motor current: its motion and its force, relative to
//! those at the torque robot.
//!
//! Random arms and drives; true kp at both ends of the interval, and as declared. Medians over the arms whose torque robot is not
//! stopped. With MuJoCo, its medians are printed too.

use crate::draw::Draw;
use crate::plot::{BLUE, GREEN, Line, ORANGE, Panel, draw};
use crate::{Completed, median, run, sorted};
use opspace_backend::CommandKind;
use opspace_sim::PhysicsEngine;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Half-widths of the interval, as fractions of the gains.
const WIDTHS: [f64; 7] = [0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3];

/// True kp within its interval, with names and colours.
const PLACES: [(f64, &str, plotters::style::RGBColor); 3] =
    [(-1.0, "the lower end", BLUE), (0.0, "the declared value", GREEN), (1.0, "the upper end", ORANGE)];

/// Tasks that have an operator's hand.
const TASKS: [&str; 2] = ["gravity compensation", "free compliance"];

/// A quantity of a run.
type Quantity = fn(&Completed) -> f64;

/// Quantities of the hand.
const OF_HAND: [(&str, Quantity); 2] =
    [("motion of the hand", |one| one.hand_m), ("force of the hand", |one| one.hand_n)];

/// Plants; the figure is of the first.
const PLANTS: [&str; 2] = ["own plant", "MuJoCo"];

/// Width of a line, px.
const LINE_PX: u32 = 8;

/// Runs that were stopped where the torque robot is not, and ratios to the torque robot of those that were not.
#[derive(Default)]
struct Results {
    runs: usize,
    stopped: usize,
    /// By quantity of the hand.
    ratios: [Vec<f64>; 2],
}

/// Runs all arms, prints the medians, and draws them.
pub fn draw_figure(path: &str, arms: usize, seed: u64, mujoco: Option<Arc<dyn PhysicsEngine>>) {
    let engines: Vec<Option<Arc<dyn PhysicsEngine>>> =
        std::iter::once(None).chain(mujoco.map(Some)).collect();
    // By task, plant, place and width.
    let mut all: BTreeMap<[usize; 4], Results> = BTreeMap::new();
    for (plant, engine) in engines.iter().enumerate() {
        for number in 0..arms {
            let declared = Draw::with_gain(number, seed, false, Some(0.0), Some(0.0));
            let hands = hand_tasks(&declared, seed);
            for (task, text) in hands.iter().enumerate() {
                let robot = declared.robot();
                let Ok(torque) = run(&robot, text, CommandKind::Torque, None, engine.clone()) else {
                    continue;
                };
                for (width_place, width) in WIDTHS.iter().enumerate() {
                    for (place, (end, ..)) in PLACES.iter().enumerate() {
                        let drawn = Draw::with_gain(number, seed, false, Some(*width), Some(end * width));
                        let outcome = run(&drawn.robot(), text, CommandKind::Position, None, engine.clone());
                        let results = all.entry([task, plant, place, width_place]).or_default();
                        results.add(&outcome.ok(), &torque);
                    }
                }
            }
        }
    }
    let mut panels = Vec::new();
    for (quantity, (of_hand, _)) in OF_HAND.iter().enumerate() {
        for (task, name) in TASKS.iter().enumerate() {
            let mut lines = Vec::new();
            for (place, (_, place_name, color)) in PLACES.iter().enumerate() {
                let points = (0..WIDTHS.len()).map(|width| {
                    let results = &all[&[task, 0, place, width]];
                    (100.0 * WIDTHS[width], median(&sorted(results.ratios[quantity].iter().copied())))
                });
                lines.push(Line::new(&format!("kp at {place_name}"), *color, LINE_PX, points.collect()));
            }
            let title = format!("{name}: {of_hand}");
            let x_label = "half-width of the gains' interval, %".to_owned();
            panels.push(Panel { x_label, ..Panel::over_time(&title, "relative to the torque robot", lines) });
        }
    }
    for ([task, plant, place, width], results) in &all {
        let Results { runs, stopped, ratios } = results;
        let of = |quantity: usize| median(&sorted(ratios[quantity].iter().copied()));
        println!(
            "{}, {}, kp at {}, {:.0} %: {stopped} of {runs} stopped, motion x {:.3}, force x {:.3}",
            TASKS[*task],
            PLANTS[*plant],
            PLACES[*place].1,
            100.0 * WIDTHS[*width],
            of(0),
            of(1),
        );
    }
    draw(path, 2, &panels).expect("a figure");
}

/// Texts of the tasks with a hand, in the order of [`TASKS`].
fn hand_tasks(drawn: &Draw, seed: u64) -> Vec<String> {
    let tasks = drawn.tasks(seed);
    TASKS.map(|name| tasks.iter().find(|(of, _)| *of == name).expect("a task").1.clone()).to_vec()
}

impl Results {
    fn add(&mut self, outcome: &Option<Completed>, torque: &Completed) {
        self.runs += 1;
        match outcome {
            None => self.stopped += 1,
            Some(one) => {
                for (ratios, (_, of)) in self.ratios.iter_mut().zip(OF_HAND) {
                    ratios.push(of(one) / of(torque));
                }
            }
        }
    }
}
