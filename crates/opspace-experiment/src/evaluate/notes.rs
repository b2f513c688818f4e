//! Notes under the tables of results: they explain terms, columns and what is missing.

use crate::codes::Code;
use crate::evaluate::position_control::lag_m;
use crate::evaluate::response_table::response_note;
use crate::evaluate::results::{error_of_desired, group, has_value, task_table};
use crate::evaluate::summary::Summary;
use crate::files::controller_kind::ControllerKind;
use crate::files::source::KeyPath;
use crate::metrics::metric::Metric;
use crate::metrics::metric_tables::{JointMetrics, PoseErrors, TaskMetrics};
use crate::text::format_short;
use opspace_backend::CommandKind;
use std::collections::{BTreeMap, BTreeSet};

/// Note under tables of simulated runs.
const OF_SIMULATION: &str =
    "values are from simulation. The parameters of the arm are partly assumed; its robot.toml marks which.";
/// Note under tables that compare simulated runs.
const OF_ONE_PLANT: &str = "Position, velocity and torque robots share one plant, one interface rate and one measurement. \
                            Their velocities are those that the page of a run names under 'joint velocities': measured, filtered \
                            differences, or an estimate of the model.";
/// Note under tables with runs of a real robot.
const OF_A_ROBOT: &str = "Values of a real robot are from its own measurements; those that need the true state or the true \
                          motor torque are missing.";
/// Note under tables that compare torque control with inverse kinematics under an operator's force.
const OF_AN_OPERATOR: &str = "Tracking alone does not justify torque control: with velocity lead, inverse kinematics tracks as \
                              well. Compliance, contact and a specified stiffness do: see the columns 'operator force rms' \
                              and 'hand motion rms'.";
/// Note under tables with force and motion of an operator.
const OF_A_HAND: &str = "Operator force and hand motion: over the axes that the task file lists (report); the motion is that from \
                         the start.";
/// Note under tables with torque errors.
const OF_TORQUE_ERRORS: &str = "Torque error: rms of motor torque minus desired torque, relative to the rms of the desired torque: \
                                at servo rate, of the means over each interval between two setpoints, and in the first servo \
                                period after each control cycle ('tick'), which does not show the torque between setpoints.";
/// Note under tables with durations.
const OF_TIMES: &str =
    "Cycle time (median) and times real time: of the whole run, measured on the computer on which it ran.";

/// Note under tables of runs that differ in the seed.
const OF_SEEDS: &str = "Rows are medians over the seeds. After ± is the distance to the farther end of the interval that contains the median \
                        of all seeds with a probability of 95 % (order statistics), with fewer than six runs of the lowest and the \
                        highest value.";

/// Notes above tables of results: values of each robot that are assumed, and on which its results rest.
#[must_use]
pub fn assumed_notes<'a>(summaries: impl IntoIterator<Item = &'a Summary>) -> Vec<String> {
    let robots: BTreeMap<&str, &[String]> = summaries
        .into_iter()
        .filter(|summary| !summary.assumed.is_empty())
        .map(|summary| (summary.robot.as_str(), summary.assumed.as_slice()))
        .collect();
    let note = |(robot, keys): (&str, &[String])| {
        let keys = assumed_text(keys);
        format!("all results of robot '{robot}' rest on assumed values (`assumed` in its robot.toml): {keys}")
    };
    robots.into_iter().map(note).collect()
}

/// Longest list of kinds in a count of assumed values, in characters.
const KINDS_WIDTH: usize = 56;

/// Counts the values of each robot that are assumed, in one line; [`assumed_notes`] lists them.
#[must_use]
pub fn assumed_counts<'a>(summaries: impl IntoIterator<Item = &'a Summary>) -> Vec<String> {
    let robots: BTreeMap<&str, &[String]> = summaries
        .into_iter()
        .filter(|summary| !summary.assumed.is_empty())
        .map(|summary| (summary.robot.as_str(), summary.assumed.as_slice()))
        .collect();
    robots.into_iter().map(|(robot, keys)| format!("robot '{robot}' has {}", assumed_count(keys))).collect()
}

/// Counts assumed keys by their kinds, as far as they fit into a line.
#[must_use]
pub fn assumed_count(keys: &[String]) -> String {
    let mut kinds: Vec<(String, &str, usize)> = Vec::new();
    for key in keys {
        let words = key.as_str().segments();
        let (kind, noun) = match words.as_slice() {
            [first, _, rest @ ..] if ["joint", "group"].contains(&first.as_str()) && !rest.is_empty() => {
                (rest.join("."), if first == "joint" { "joint" } else { "group" })
            }
            _ => (key.clone(), ""),
        };
        match kinds.iter_mut().find(|(known, of, _)| *known == kind && *of == noun) {
            Some((_, _, count)) => *count += 1,
            None => kinds.push((kind, noun, 1)),
        }
    }
    let text = |(kind, noun, count): &(String, &str, usize)| match (*noun, count) {
        ("", _) => kind.clone(),
        (noun, 1) => format!("{kind} of 1 {noun}"),
        (noun, count) => format!("{kind} of {count} {noun}s"),
    };
    let (mut list, mut shown) = (String::new(), 0);
    for text in kinds.iter().map(text) {
        if shown > 0 && list.chars().count() + text.chars().count() > KINDS_WIDTH {
            break;
        }
        list += &format!("{}{text}", if shown > 0 { ", " } else { "" });
        shown += 1;
    }
    let rest = if shown < kinds.len() { ", …" } else { "" };
    let values = if keys.len() == 1 { "1 assumed value" } else { &format!("{} assumed values", keys.len()) };
    format!("{values}: {list}{rest}")
}

/// Notes above tables of results: refusals that the user has allowed, each once.
#[must_use]
pub fn allowed_notes<'a>(summaries: impl IntoIterator<Item = &'a Summary>) -> Vec<String> {
    let all = summaries.into_iter().flat_map(|summary| &summary.allowed).map(ToString::to_string);
    all.collect::<BTreeSet<String>>().into_iter().collect()
}

/// Lists assumed keys; those of joints are sorted by their kind.
#[must_use]
pub fn assumed_text(keys: &[String]) -> String {
    let mut kinds: Vec<(String, Vec<String>)> = Vec::new();
    for key in keys {
        let words = key.as_str().segments();
        let (kind, joint) = match words.as_slice() {
            [first, joint, rest @ ..] if first == "joint" && !rest.is_empty() => {
                (rest.join("."), Some(joint.clone()))
            }
            _ => (key.clone(), None),
        };
        match kinds.iter_mut().find(|(known, joints)| *known == kind && joint.is_some() && !joints.is_empty())
        {
            Some((_, joints)) => joints.extend(joint),
            None => kinds.push((kind, joint.into_iter().collect())),
        }
    }
    let text = |(kind, joints): (String, Vec<String>)| match joints.is_empty() {
        true => kind,
        false => format!("{kind} of {}", joints.join(", ")),
    };
    kinds.into_iter().map(text).collect::<Vec<_>>().join("; ")
}

/// Notes under a table of results with these columns.
#[must_use]
pub fn notes(summaries: &[Summary], metrics: &[Metric]) -> Vec<String> {
    let groups = group(summaries);
    let shows = |key: &str| metrics.iter().any(|metric| metric.key == key && has_value(summaries, metric));
    let shows_one = |keys: &[&str]| keys.iter().any(|key| shows(key));
    let mut notes = vec![terms(summaries)];
    if let [one] = summaries {
        notes.extend([transformer_choice(one), judged_task(one), response_note(one)].into_iter().flatten());
    }
    let mut add = |is_true: bool, note: &str| notes.extend(is_true.then(|| note.to_owned()));
    add(groups.iter().any(|group| group.runs.len() > 1), OF_SEEDS);
    let times = shows_one(&["tick_ns_median", "realtime_factor"]);
    add(times, OF_TIMES);
    replay_notes(summaries).iter().for_each(|note| add(true, note));
    let simulated = summaries.iter().any(|summary| summary.simulated);
    add(simulated, &format!("{} {OF_SIMULATION}", if times { "All other" } else { "All" }));
    add(simulated && groups.len() > 1, OF_ONE_PLANT);
    add(summaries.iter().any(|summary| !summary.simulated), OF_A_ROBOT);
    add(shows_one(&["hand_force_rms_n", "hand_motion_rms_m"]), OF_A_HAND);
    let controllers = |torque: bool| summaries.iter().any(|summary| (summary.controller == "osc") == torque);
    add(shows("hand_force_rms_n") && controllers(true) && controllers(false), OF_AN_OPERATOR);
    let torque_errors = ["torque_error_servo", "torque_error_interval", "torque_error_tick"];
    add(shows_one(&torque_errors), OF_TORQUE_ERRORS);
    notes
}

/// Notes of runs on logs: whether their commands are those of the log.
#[must_use]
pub fn replay_notes(summaries: &[Summary]) -> Vec<String> {
    let note = |summary: &Summary| {
        let (replay, plant) = (summary.replay.as_ref()?, summary.plant.as_ref()?);
        Some(format!("'{}' on {plant}: {}", summary.task, replay.text()))
    };
    summaries.iter().filter_map(note).collect()
}

/// Explains the names of controllers and the ratios of rates in a table.
fn terms(summaries: &[Summary]) -> String {
    let known = [
        ("osc", "operational-space control"),
        ("ik", "inverse kinematics"),
        ("ik-lead", "inverse kinematics with velocity lead"),
    ];
    let is_used = |name: &str| summaries.iter().any(|summary| summary.controller == name);
    let used = known.into_iter().filter(|(name, _)| is_used(name));
    let mut texts: Vec<String> = used.map(|(name, term)| format!("{name}: {term}.")).collect();
    let mut ratios: Vec<u32> = summaries.iter().map(|summary| summary.ratio).collect();
    ratios.sort_unstable();
    ratios.dedup();
    texts.push(match ratios[..] {
        [1] => "1:1: a command every servo tick.".to_owned(),
        [ratio] => format!("1:{ratio}: a command every {ratio} servo ticks."),
        _ => "1:n: a command every n servo ticks.".to_owned(),
    });
    texts.join(" ")
}

/// Names the transformer of a run, with the reason for its choice.
fn transformer_choice(summary: &Summary) -> Option<String> {
    let (name, reason) = (summary.transformer.as_ref()?, summary.transformer_reason.as_ref()?);
    Some(format!("Transformer '{name}': {reason}."))
}

/// Names the task whose errors of the pose are those of the run, if others have some too.
fn judged_task(summary: &Summary) -> Option<String> {
    let with_errors = summary.tasks.iter().filter(|(_, task)| task.pose != PoseErrors::default());
    let (name, _) = with_errors.clone().find(|(_, task)| task.pose == summary.metrics.pose)?;
    (with_errors.count() > 1).then(|| {
        format!("Errors of position and orientation: those of task '{name}', the first with such errors.")
    })
}

/// Largest errors at the end of a run of a task that has reached its goal, m and rad.
pub(crate) const REACHED: [f64; 2] = [5e-3, 20e-3];

/// Largest final error of the force of a task that has reached its target, N.
const FORCE_REACHED_N: f64 = 1.0;

/// Note of a task whose force is away from its target at the end.
fn force_away(name: &str, task: &TaskMetrics) -> Option<String> {
    let error_n = task.contact.force_final_n.filter(|error_n| *error_n > FORCE_REACHED_N)?;
    // Without any contact the run has failed, and says so.
    (task.contact.in_contact_fraction != Some(0.0)).then(|| {
        let tared = tared_in_contact(task);
        let tared = if tared.is_empty() {
            "; run longer (`--duration-s`) if it still approaches it, or raise `force.integral_per_s`"
        } else {
            tared
        };
        format!("task '{name}': the true force is {error_n:.1} N (rms) away from its target in the last half second{tared}")
    })
}

/// Time after the start of control in which a contact began that there was before, s.
const FROM_THE_START_S: f64 = 2e-3;

/// Explanation of a force error by a contact at the start.
fn tared_in_contact(task: &TaskMetrics) -> &'static str {
    match task.contact.contact_begin_s {
        Some(begin_s) if begin_s <= FROM_THE_START_S => {
            "; the frame touched something already at the start: a sensor that is tared then takes this force as its zero; start away from it (`start_rad`)"
        }
        _ => "",
    }
}

/// Number of times that a sensor may lose contact more often than the frame before a note says so.
const FALSE_LOSSES: u64 = 3;

/// Note of a task whose sensor lost contact although the frame still touched.
fn false_losses(name: &str, task: &TaskMetrics) -> Option<String> {
    let (sensed, lost) = (task.contact.sensed_contact_losses?, task.contact.contact_losses?);
    (sensed > lost + FALSE_LOSSES).then(|| {
        format!(
            "task '{name}': it took its contact as lost {sensed} times, because of the sensed force, and approached anew; the frame \
             lost contact {lost} times; raise `force.contact.lost_after_s`, or lower `lost_below_n`"
        )
    })
}

/// Time within which a stop hardly depends on the motion of the arm, s.
const EARLY_STOP_S: f64 = 10e-3;

/// Note about a simulated run that is stopped before an arm could move.
fn early_stop(summary: &Summary) -> Option<String> {
    let time_s = summary.fault_time_s.filter(|time_s| summary.simulated && *time_s < EARLY_STOP_S)?;
    Some(format!(
        "stopped {:.1} ms after the start: an arm hardly moves in this time, so the cause is probably the simulation \
         ([simulated], masses, rotors and servo gains of the robot), not the task: `opspace check ROBOT` examines them",
        1e3 * time_s
    ))
}

/// Least share of the error of a task with inverse kinematics that is sag, if the arm rests with this sag at the end.
const SAGGED: f64 = 0.5;

/// Note of a task of inverse kinematics on a position robot whose servos sag under the weight of the arm, and lag behind a moving
/// reference.
fn sag(summary: &Summary, name: &str, task: &TaskMetrics) -> Option<String> {
    if summary.controller != ControllerKind::Ik.name() || summary.backend != CommandKind::Position.name() {
        return None;
    }
    let rms_m = task.pose.position_rms_m.filter(|rms_m| *rms_m > REACHED[0])?;
    let lead = "`--controller ik-lead` compensates both, and is the fair baseline";
    let mm = |error_m: f64| format!("{:.1} mm", 1e3 * error_m);
    if let Some(force_n) = task.response.external_force_max_n {
        return Some(format!(
            "task '{name}': {} rms from its reference, under a force of up to {} N: servos yield to it and to the weight of the arm, \
             with a stiffness that nobody has chosen; `--controller osc` with an `impedance` has a chosen one",
            mm(rms_m),
            format_short(force_n)
        ));
    }
    let Some(sag_m) = task.pose.position_final_m else {
        return Some(format!(
            "task '{name}': {} rms from its moving reference: lag of the servos behind the motion, and sag under the weight of the \
             arm, which has no integral against it; {lead}",
            mm(rms_m)
        ));
    };
    if sag_m < SAGGED * rms_m {
        return None;
    }
    Some(format!(
        "task '{name}': {} from its resting reference at the end: sag, as servos without an integral yield to the weight of the arm; \
         of the error of {} rms, lag in motion is about {}; {lead}",
        mm(sag_m),
        mm(rms_m),
        mm(lag_m(rms_m, sag_m))
    ))
}

/// Causes of an error at rest that no finding explains, with what to try.
fn away_causes(summary: &Summary) -> &'static str {
    match summary.controller == ControllerKind::Osc.name() {
        true => {
            "a load that the model lacks (`environment`, `tool`), friction (`friction_compensation.gain`) or a contact holds it, or \
             it still moves (`--duration-s`); higher `gains` bring it closer"
        }
        false => "the servos sag or still move (`--duration-s`); `--controller ik-lead` compensates the sag",
    }
}

/// Notes above the tables of a run: a stop that the simulation probably caused; tasks that are away from their references at
/// its end, although these rest there, or from the target of their force, and tasks whose force sensor lost contact that there
/// was. Those that a finding explains are not listed.
#[must_use]
pub fn final_notes(summary: &Summary) -> Vec<String> {
    if summary.faulted.is_some() || summary.interrupted {
        return early_stop(summary).into_iter().collect();
    }
    let is_explained = |name: &str| {
        let goals =
            summary.findings.of(Code::GoalNotReached).chain(summary.findings.of(Code::SpringDeflected));
        let mut to_the_end = goals.filter(|goal| goal.number("end_s").is_none());
        to_the_end.any(|goal| goal.task() == Some(name))
    };
    let tasks = summary.ordered_tasks().filter(|(name, _)| !is_explained(name));
    let note = |(name, task): (&String, &TaskMetrics)| {
        if let Some(note) = sag(summary, name, task) {
            return Some(note);
        }
        let errors = [task.pose.position_final_m, task.pose.orientation_final_rad];
        let is_away = errors.iter().zip(REACHED).any(|(error, most)| error.is_some_and(|error| error > most));
        let units = errors.iter().zip(["mm", "mrad"]);
        let texts: Vec<String> =
            units.filter_map(|(error, unit)| Some(format!("{:.1} {unit}", 1e3 * (*error)?))).collect();
        // A reference that moves at the end has no final error.
        let moving = task.pose.position_max_m.filter(|_| task.pose.position_final_m.is_none());
        let moving = moving.map_or(String::new(), |most| {
            format!("; its position reference moves then, at most {:.1} mm away during the run", 1e3 * most)
        });
        is_away.then(|| {
            let texts = texts.join(" and ");
            let causes = away_causes(summary);
            format!("task '{name}': goal not reached, {texts} away at the end of the run{moving}; {causes}")
        })
    };
    let forces =
        summary.ordered_tasks().flat_map(|(name, task)| [force_away(name, task), false_losses(name, task)]);
    tasks.filter_map(note).chain(forces.flatten()).collect()
}

/// Notes under [`task_table`]: the tasks that are not in it, each with the reason.
#[must_use]
pub fn task_notes(summary: &Summary) -> Vec<String> {
    let table = task_table(summary);
    let is_shown = |name: &str| table.rows.iter().any(|row| row[0] == name.into());
    let missing = summary.tasks.iter().filter(|(name, _)| !is_shown(name));
    let note = |(name, task): (&String, &TaskMetrics)| {
        let reason = match task.kind.as_str() {
            "joint-posture" => {
                "it pulls the joints to a posture that they need not reach, so it has no error"
            }
            "joint-damping" => "it damps the joints without a reference, so it has no error",
            _ => "the log has no error of it after settle_s",
        };
        format!("Task '{name}' ({}) is not in the table: {reason}.", task.kind)
    };
    missing.map(note).collect()
}

/// Notes under [`joint_table`](crate::evaluate::results::joint_table).
#[must_use]
pub fn joint_notes(summary: &Summary) -> Vec<String> {
    let has = |missing: fn(&JointMetrics) -> bool| summary.joints.values().any(missing);
    let mut notes = Vec::new();
    let mut add = |is_true: bool, note: &str| notes.extend(is_true.then(|| note.to_owned()));
    add(
        has(|joint| joint.torque_error_of_desired.is_some() && error_of_desired(joint).is_none()),
        "Torque error of desired is – if the desired torque (rms) is less than 1 % of the limit.",
    );
    add(
        has(|joint| joint.torque_chatter_rms_nm.is_some()),
        "The desired torque above 8 Hz includes fast parts of the planned motion and of friction compensation. Largest line is \
         the frequency of its largest part.",
    );
    add(
        has(|joint| joint.torque_chatter_rms_nm.is_some() && joint.torque_chatter_hz.is_none()),
        "Largest line is – if the spectrum only falls from 8 Hz on.",
    );
    notes
}

#[cfg(test)]
mod tests {
    use super::{assumed_count, final_notes, joint_notes, notes, task_notes};
    use crate::codes::Code;
    use crate::evaluate::results::tests::summary;
    use crate::evaluate::results::{joint_table, task_table};
    use crate::evaluate::summary::Summary;
    use crate::extensions::Entry;
    use crate::finding::{Finding, Place};
    use crate::metrics::metric::Metric;
    use crate::metrics::metric_tables::{JointMetrics, TaskMetrics};

    /// Checks joints whose desired torque is 0.5 % and 5 % of the limit, and one without a line above 8 Hz: cells and notes.
    #[test]
    fn torques_that_say_nothing_are_dashes() {
        let joint = |of_desired: f64, line_hz: Option<f64>| JointMetrics {
            torque_error_rms_nm: Some(0.1),
            torque_error_of_limit: Some(0.002),
            torque_error_of_desired: Some(of_desired),
            torque_chatter_rms_nm: Some(0.2),
            torque_chatter_hz: line_hz,
            torque_saturated_fraction: None,
        };
        let mut run = summary("a", "p", 1, 0.1);
        run.joints.insert("large".to_owned(), joint(0.04, Some(15.0)));
        assert_eq!(joint_table(&run).texts()[0][3..6], ["4.000", "0.2000", "15.00"]);
        assert_eq!(joint_notes(&run).len(), 1);
        run.joints.insert("small".to_owned(), joint(0.4, None));
        assert_eq!(joint_table(&run).texts()[1][3..6], ["–", "0.2000", "–"]);
        assert_eq!(joint_notes(&run).len(), 3);
    }

    /// Checks units and names of the quantities of a task, and that a task without any is named with the reason.
    #[test]
    fn tasks_are_in_millimetres_or_named_below() {
        let mut run = summary("a", "p", 1, 0.1);
        let mut hand = TaskMetrics { kind: "cartesian".to_owned(), ..TaskMetrics::default() };
        (hand.pose.position_rms_m, hand.pose.position_max_m) = (Some(8.651e-3), Some(13.249e-3));
        hand.pose.position_final_m = Some(6.2e-3);
        hand.contact.contact_peak_n = Some(15.4);
        run.tasks.insert("hand".to_owned(), hand);
        let rest = TaskMetrics { kind: "joint-posture".to_owned(), ..TaskMetrics::default() };
        run.tasks.insert("rest".to_owned(), rest);
        let expected = [
            ["hand", "position error", "8.65", "13.25", "6.20", "mm"],
            ["hand", "force in the first second of contact", "–", "15.40", "–", "N"],
        ];
        assert_eq!(task_table(&run).texts(), expected);
        let [note] = &task_notes(&run)[..] else { panic!("one note") };
        assert!(note.starts_with("Task 'rest' (joint-posture) is not in the table: "), "{note}");
    }

    /// Checks stops 2 ms and 50 ms after the start, of a simulation and of a robot.
    #[test]
    fn stops_at_the_start_are_attributed_to_the_simulation() {
        let mut run = summary("a", "p", 1, 0.1);
        run.faulted = Some("joint 'a': too fast".to_owned());
        for (time_s, simulated, is_noted) in [(0.002, true, true), (0.05, true, false), (0.002, false, false)]
        {
            (run.fault_time_s, run.simulated) = (Some(time_s), simulated);
            let notes = final_notes(&run).join("\n");
            assert_eq!(notes.contains("2.0 ms after the start"), is_noted, "{notes}");
        }
    }

    /// Checks tasks at 4 mm and at 12 mm from their goals, one whose reference moves, and one whose error is explained.
    #[test]
    fn goals_that_are_missed_at_the_end_are_noted() {
        let mut run = summary("a", "p", 1, 0.1);
        for (name, final_m) in
            [("near", Some(4e-3)), ("far", Some(12e-3)), ("moving", None), ("known", Some(0.1))]
        {
            let mut task = TaskMetrics { kind: "cartesian".to_owned(), ..TaskMetrics::default() };
            task.pose.position_final_m = final_m;
            run.tasks.insert(name.to_owned(), task);
        }
        run.findings.extend([Finding::of(
            Code::GoalNotReached,
            Place::Task("known".to_owned()),
            String::new(),
        )]);
        let [note] = &final_notes(&run)[..] else { panic!("one note") };
        let causes =
            "task 'far': goal not reached, 12.0 mm away at the end of the run; a load that the model lacks";
        assert!(note.starts_with(causes) && note.contains("`friction_compensation.gain`"), "{note}");
        run.tasks.retain(|name, _| name == "moving");
        let pose = &mut run.tasks.entry("moving".to_owned()).or_default().pose;
        (pose.position_max_m, pose.orientation_final_rad) = (Some(99e-3), Some(0.03));
        let moving = "task 'moving': goal not reached, 30.0 mrad away at the end of the run; its position reference moves then, at \
                      most 99.0 mm away during the run; ";
        assert!(final_notes(&run)[0].starts_with(moving), "{:?}", final_notes(&run));
        run.faulted = Some("a fault".to_owned());
        assert!(final_notes(&run).is_empty());
    }

    /// Checks what inverse kinematics says of an error that rests, of one in motion, and of a small one, and that a torque
    /// controller says nothing of servos. √(10² − 8²) mm are 6 mm.
    #[test]
    fn sag_and_lag_of_servos_are_noted() {
        let mut run = summary("a", "p", 1, 0.1);
        run.controller = "ik".to_owned();
        let noted = |run: &mut Summary, rms_m, final_m| {
            let pose = &mut run.tasks.entry("hand".to_owned()).or_default().pose;
            (pose.position_rms_m, pose.position_final_m) = (Some(rms_m), final_m);
            final_notes(run).join("\n")
        };
        let sag = noted(&mut run, 10e-3, Some(8e-3));
        for words in
            ["8.0 mm from its resting", "sag", "10.0 mm rms", "about 6.0 mm", "`--controller ik-lead`"]
        {
            assert!(sag.contains(words), "{words}: {sag}");
        }
        let moving = noted(&mut run, 7.7e-3, None);
        assert!(moving.contains("7.7 mm rms from its moving") && moving.contains("ik-lead"), "{moving}");
        assert_eq!(noted(&mut run, 1e-3, Some(1e-3)), "");
        run.controller = "ik-lead".to_owned();
        assert_eq!(noted(&mut run, 7.7e-3, None), "");
    }

    /// Checks that the count of assumed values is one line.
    #[test]
    fn assumed_values_are_counted_in_a_line() {
        let kinds = ["torque_limit_nm", "friction.static_nm", "friction.coulomb_nm", "rotor_inertia_kg_m2"];
        let of_joints = kinds.iter().flat_map(|kind| ["a", "b"].map(|joint| format!("joint.{joint}.{kind}")));
        assert!(assumed_count(&["group.wrist.rotor".to_owned()]).ends_with(": rotor of 1 group"));
        let keys: Vec<String> = of_joints.collect();
        assert_eq!(assumed_count(&keys[..1]), "1 assumed value: torque_limit_nm of 1 joint");
        let count = assumed_count(&keys);
        let begin = "8 assumed values: torque_limit_nm of 2 joints, ";
        assert!(count.starts_with(begin) && count.ends_with(", …"), "{count}");
        assert!(count.len() < 90, "{count}");
    }

    /// Checks forces at 0.9 N and 1.1 N from their targets, a contact from the start, and contacts that only the sensor lost.
    #[test]
    fn forces_that_are_missed_at_the_end_are_noted() {
        let mut run = summary("a", "p", 1, 0.1);
        let mut noted = |final_n, begin_s, sensed| {
            let mut task = TaskMetrics { kind: "cartesian".to_owned(), ..TaskMetrics::default() };
            let contact = &mut task.contact;
            (contact.force_final_n, contact.contact_begin_s) = (Some(final_n), Some(begin_s));
            (contact.sensed_contact_losses, contact.contact_losses) = (Some(sensed), Some(1));
            contact.in_contact_fraction = Some(0.9);
            run.tasks.insert("press".to_owned(), task);
            final_notes(&run).join("\n")
        };
        assert_eq!(noted(0.9, 0.0, 4), "");
        let away = "task 'press': the true force is 1.1 N (rms) away from its target in the last half second";
        let more = "; run longer (`--duration-s`) if it still approaches it, or raise `force.integral_per_s`";
        assert_eq!(noted(1.1, 0.5, 4), format!("{away}{more}"));
        assert!(
            noted(1.1, 0.0, 4)
                .starts_with(&format!("{away}; the frame touched something already at the start"))
        );
        assert!(noted(0.9, 0.0, 5).contains("took its contact as lost 5 times"));
    }

    /// Checks that notes explain the columns that are shown, and no others.
    #[test]
    fn notes_are_about_the_columns_shown() {
        let runs = [summary("a", "p", 1, 0.1)];
        let text = |keys: &[&str]| {
            let metrics = Metric::built_in().iter().filter(|metric| keys.contains(&metric.key));
            notes(&runs, &metrics.cloned().collect::<Vec<_>>()).join("\n")
        };
        let without = text(&["position_rms_m"]);
        assert!(
            !without.contains("Cycle time") && without.contains("All values are from simulation."),
            "{without}"
        );
        let with = text(&["position_rms_m", "tick_ns_median"]);
        assert!(
            with.contains("Cycle time") && with.contains("All other values are from simulation."),
            "{with}"
        );
        assert!(
            with.contains("osc: operational-space control. 1:5: a command every 5 servo ticks."),
            "{with}"
        );
    }
}
