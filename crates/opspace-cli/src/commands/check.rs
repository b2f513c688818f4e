//! `opspace check`: checks files, individually and against each other, without running anything, and reports
//! predicted problems of a task.

use crate::cli::{CheckArgs, ControlArgs};
use crate::commands::margins::Strength;
use crate::console::LISTED;
use crate::console::{Console, Exit, Outcome, report};
use crate::output::pretty;
use crate::outputs::check_outputs;
use opspace_experiment::codes::AllowedRefusal;
use opspace_experiment::evaluate::notes::{assumed_count, assumed_text};
use opspace_experiment::files::collision::capsule_warning_texts;
use opspace_experiment::files::joint_layers::urdf_values_text;
use opspace_experiment::files::origin::Kind;
use opspace_experiment::files::robot::load_urdf;
use opspace_experiment::run::collision::KeptDistances;
use opspace_experiment::transformers::check_robot;
use opspace_experiment::{
    Code, ControllerKind, Experiment, Extensions, FileError, Files, Finding, RobotDefinition, RunOptions,
    Scenario, Source,
};
use opspace_model::collision::DropReason;
use opspace_model::{Model, UrdfOptions, UrdfWarning, model_warnings};
use opspace_preflight::{
    DetectableForce, GainMargin, GearResonance, PathDuration, Reserve, ReserveOf, ServoLoop,
    SingularPostures, collision_thresholds, coupling_diagnostics, detectable_forces, diagnostics_with,
    gain_margin, gear_resonances, not_checked, path_durations, reserves, singular_postures, weak_joints,
};
use opspace_suite::Suite;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::collections::HashSet;
use std::fmt;
use std::path::Path;

pub fn check(args: &CheckArgs, extensions: &Extensions, console: Console) -> Outcome {
    check_outputs(&args.files, &Vec::from_iter(args.json.path().map(Path::to_owned)))?;
    let (mut is_valid, mut has_problems) = (true, false);
    let (mut text, mut files) = (String::new(), Vec::new());
    for path in &args.files {
        let checked = check_one(path, args, extensions, console);
        files.push(as_json(path, &checked));
        match checked {
            Ok(checked) => {
                has_problems |= checked.has_problems();
                text += &checked.text(path, console);
            }
            Err(error) => {
                report(&error.into());
                is_valid = false;
            }
        }
    }
    args.json.print(|| pretty(&json!({ "schema": "opspace.check/1", "files": files })), || text)?;
    Ok(match is_valid {
        false => Exit::Bad,
        true if args.strict && has_problems => Exit::Failed,
        true => Exit::Done,
    })
}

/// Valid file with the predicted problems of its task.
#[derive(Default)]
struct Checked {
    /// Kind of the file.
    what: String,
    /// True for a task file, whose problems are predicted.
    is_task: bool,
    /// Values of a robot that its file does not state, and those that are assumed.
    values: String,
    /// Text of the values with the number of those that are assumed, in place of their list.
    short_values: String,
    /// Gain margin of a task whose torques pass through a transformer.
    margin: Option<GainMargin>,
    /// Frequencies of the joints whose gear stiffness is declared.
    gears: Vec<GearResonance>,
    /// Smallest forces of the estimated force sensors.
    forces: Vec<DetectableForce>,
    /// Thresholds of the collision detection at the start, Nm (N).
    thresholds: Vec<(String, f64)>,
    /// Margins and errors of the transformer, if torques pass through one.
    strength: Option<Strength>,
    /// Joints that reach a limit first.
    reserves: Vec<Reserve>,
    /// Nearly singular postures of each task.
    singular: Vec<SingularPostures>,
    /// Estimate of the size of the log, if it is large.
    large_log: Option<String>,
    /// Durations of the paths that tasks follow.
    paths: Vec<PathDuration>,
    /// Pairs of links and obstacles that the controller keeps apart.
    distances: Option<KeptDistances>,
    /// Warnings about a URDF, the model built from it, and its capsules.
    warnings: Vec<Warning>,
    found: Vec<Found>,
    /// Refusals that the user has allowed.
    allowed: Vec<AllowedRefusal>,
    /// Parts that could not be checked.
    skipped: Vec<Found>,
}

impl Checked {
    /// Finds the problems of all robots of these scenarios and of their couplings.
    fn of_scenarios(extensions: &Extensions, what: String, scenarios: &[Scenario]) -> Self {
        let experiments = || scenarios.iter().flat_map(Scenario::experiments);
        let mut found = find(experiments(), |experiment| diagnostics_with(extensions, experiment));
        found.extend(find_in_couplings(scenarios));
        let mut allowed: Vec<AllowedRefusal> = Vec::new();
        for refusal in experiments().flat_map(Experiment::allowed) {
            if !allowed.contains(refusal) {
                allowed.push(refusal.clone());
            }
        }
        let skipped = find(experiments(), not_checked);
        Self { what, found, allowed, skipped, ..Self::default() }
    }

    /// Adds the warnings of the drivers that a run opens with the same options: none if it is a simulation.
    fn with_drivers(
        mut self,
        extensions: &Extensions,
        scenario: &Scenario,
        args: &CheckArgs,
    ) -> Result<Self, FileError> {
        for experiment in scenario.experiments().filter(|_| !args.simulate) {
            for warning in experiment.check_driver(extensions)? {
                add(&mut self.found, Found::new(warning, experiment));
            }
        }
        Ok(self)
    }

    /// Adds the margins, durations, distances and values of a single robot.
    fn with_details(self, experiment: &Experiment) -> Self {
        let margin = gain_margin(experiment);
        let strength = Strength::of(experiment);
        let small = margin.as_ref().and_then(|margin| margin.finding(experiment));
        let of_transformer = strength.iter().flat_map(|strength| strength.diagnostics(experiment));
        let more = small.into_iter().chain(of_transformer).map(|new| Found::new(new, experiment));
        Self {
            is_task: true,
            values: values_text(experiment.robot()),
            short_values: short_values_text(experiment.robot()),
            gears: gear_resonances(experiment),
            forces: detectable_forces(experiment),
            thresholds: collision_thresholds(experiment),
            reserves: reserves(experiment),
            singular: singular_postures(experiment),
            paths: path_durations(experiment),
            large_log: large_log(experiment),
            distances: experiment.kept_distances().cloned(),
            warnings: capsule_warnings_of(experiment.robot()).collect(),
            found: self.found.into_iter().chain(more).collect(),
            margin,
            strength,
            ..self
        }
    }

    /// True if a problem was found, or the model has a warning.
    fn has_problems(&self) -> bool {
        !self.found.is_empty() || !self.warnings.is_empty()
    }

    /// Describes the file and its problems.
    fn text(&self, path: &Path, console: Console) -> String {
        let values = if console.verbose { &self.values } else { &self.short_values };
        let mut text = format!("{}: {}\n{values}", path.display(), self.what);
        text.extend(self.margin.iter().map(line));
        text.extend(self.gears.iter().map(line));
        text.extend(self.forces.iter().map(line));
        text += &thresholds_text(&self.thresholds);
        let strength = |strength: &Strength| {
            if console.verbose { strength.text() } else { line(&Strength::hint()) }
        };
        text.extend(self.strength.iter().map(strength));
        text.extend(self.reserves.iter().map(line));
        text.extend(self.singular.iter().map(line));
        text.extend(self.paths.iter().map(line));
        text.extend(self.large_log.iter().map(line));
        text.extend(self.distances.iter().map(|distances| pairs_text(distances, console.verbose)));
        text.extend(self.allowed.iter().map(|refusal| line(&format!("allowed: {refusal}"))));
        if self.is_task && !self.has_problems() && self.allowed.is_empty() {
            text += &line(&"no problems found");
        }
        text.extend(self.warnings.iter().map(line));
        text.extend(self.found.iter().map(line));
        text.extend(self.skipped.iter().map(|skipped| line(&format!("not checked: {}", skipped.place))));
        text
    }
}

/// Size of a log from which on it is stated before the run, bytes: it is more than many disks have left.
const LARGE_LOG_BYTES: f64 = 10e9;

/// Sentence about the size of the log of a long run.
pub fn large_log(experiment: &Experiment) -> Option<String> {
    let bytes = experiment.log_bytes();
    let text = || {
        format!(
            "the log of {} s will have about {:.0} GB (half a MB per second)",
            experiment.duration_s(),
            bytes / 1e9
        )
    };
    (bytes > LARGE_LOG_BYTES).then(text)
}

/// Formats a line about a file.
fn line(item: &impl fmt::Display) -> String {
    format!("  {item}\n")
}

/// Warning about a model, with its file and its code.
struct Warning {
    file: String,
    text: String,
    code: &'static str,
}

impl Warning {
    fn new(file: &str, text: &impl fmt::Display, code: &'static str) -> Self {
        Self { file: file.to_owned(), text: text.to_string(), code }
    }
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {} [{}]", self.file, self.text, self.code)
    }
}

/// Finding with its place.
struct Found {
    finding: Finding,
    place: FileError,
}

impl Found {
    fn new(finding: Finding, experiment: &Experiment) -> Self {
        let place = finding.placed(experiment);
        Self { finding, place }
    }
}

impl fmt::Display for Found {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.place)?;
        match self.finding.help.as_str() {
            "" => Ok(()),
            help => write!(f, "\n    help: {help}"),
        }
    }
}

/// Collects the diagnostics of these experiments without duplicates: runs that differ only in unrelated settings have
/// the same ones.
fn find<'a>(
    experiments: impl IntoIterator<Item = &'a Experiment>,
    diagnostics: impl Fn(&Experiment) -> Vec<Finding>,
) -> Vec<Found> {
    let (mut looked_at, mut found) = (HashSet::new(), Vec::<Found>::new());
    for experiment in experiments {
        // All options except the seed, which does not affect any diagnostic.
        let RunOptions { backend, controller, duration_s, .. } = experiment.options();
        let transformer = experiment.transformer_name();
        let sources = [&experiment.task().source, &experiment.robot().source].map(|s| s.text().to_owned());
        let profile = experiment.profile().0.to_owned();
        let names = [experiment.task().source.name().to_owned(), experiment.robot().source.name().to_owned()];
        let options = (*backend, *controller, transformer, duration_s.map(f64::to_bits));
        if !looked_at.insert((names, sources, profile, options)) {
            continue;
        }
        let of_experiment = diagnostics(experiment).into_iter();
        of_experiment.for_each(|finding| add(&mut found, Found::new(finding, experiment)));
    }
    found
}

/// Collects the diagnostics of couplings without duplicates.
fn find_in_couplings(scenarios: &[Scenario]) -> Vec<Found> {
    let mut found = Vec::new();
    for scenario in scenarios {
        for finding in coupling_diagnostics(scenario) {
            let place = finding.placed_in(&scenario.source);
            add(&mut found, Found { finding, place });
        }
    }
    found
}

/// Adds a diagnostic that is not yet in the list.
fn add(found: &mut Vec<Found>, new: Found) {
    let same = |old: &Found| old.finding == new.finding && old.place.path() == new.place.path();
    if !found.iter().any(same) {
        found.push(new);
    }
}

/// Warnings about a URDF and about the model built from it.
fn model_warnings_of(urdf: &str, warnings: &[UrdfWarning], model: &Model) -> Vec<Warning> {
    let of_urdf = warnings.iter().map(|w| Warning::new(urdf, w, w.kind().code()));
    of_urdf.chain(model_warnings(model).iter().map(|w| Warning::new(urdf, w, w.code()))).collect()
}

/// Warnings about the capsules of a robot, for example meshes that were not found.
fn capsule_warnings_of(robot: &RobotDefinition) -> impl Iterator<Item = Warning> {
    let texts = capsule_warning_texts(robot.capsule_warnings()).into_iter();
    texts.map(|(text, code)| Warning::new(robot.urdf.name(), &text, code))
}

/// Refuses options that a file has no values for.
fn refuse_options_of_tasks(path: &Path, args: &CheckArgs) -> Result<(), FileError> {
    let ControlArgs { backend, controller } = args.control;
    let given = [
        ("--robot", args.robot.is_some(), "its runs or robots state `robot`"),
        ("--backend", backend.is_some(), "its runs or robots state `backend`"),
        ("--controller", controller != ControllerKind::Osc, "its runs or robots state `controller`"),
        ("--transformer", args.transformer.is_some(), "its runs or robots state `transformer`"),
    ];
    let Some((option, _, help)) = given.into_iter().find(|(_, is_given, _)| *is_given) else { return Ok(()) };
    let message = format!("has no use for {option}, which is for task files");
    Err(FileError::of_file(path.display().to_string(), message, Some(help.to_owned())))
}

fn check_one(
    path: &Path,
    args: &CheckArgs,
    extensions: &Extensions,
    console: Console,
) -> Result<Checked, FileError> {
    let (settings, allow) = (args.set.as_slice(), args.allow.allow.as_slice());
    let no_settings = || match settings {
        [] => refuse_options_of_tasks(path, args),
        _ => {
            let help = "check the tasks of a suite or of a robot one by one".to_owned();
            let name = path.display().to_string();
            Err(FileError::of_file(
                &name,
                "has no values for --set, which is for task and experiment files",
                Some(help),
            ))
        }
    };
    if path.extension().is_some_and(|e| e == "urdf") {
        no_settings()?;
        let source = Source::read(path)?;
        let loaded = load_urdf(&source, UrdfOptions::default())?;
        let warnings = model_warnings_of(source.name(), &loaded.warnings, &loaded.model);
        let what = format!("a URDF of {} moving joints", loaded.model.n());
        return Ok(Checked { what, warnings, ..Checked::default() });
    }
    let file = Files::Disk.robot_file(path);
    let source = Source::read(&file)?;
    let robot = || {
        no_settings()?;
        let robot = RobotDefinition::load(Files::Disk, path, &[])?;
        check_robot(extensions, &robot)?;
        Experiment::check_simulated(&robot)?;
        let mut warnings = model_warnings_of(robot.urdf.name(), &robot.warnings, &robot.model);
        warnings.extend(capsule_warnings_of(&robot));
        let (values, short_values) = (values_text(&robot), short_values_text(&robot));
        robot.defaults().iter().for_each(|default| console.detail(&format!("  {default}")));
        let what = format!("a robot of {} joints", robot.model.n());
        let place = |finding: Finding| Found { place: finding.placed_in(&robot.source), finding };
        let mut findings = weak_joints(&robot);
        if let (Some(settings), false) = (robot.default_driver_settings(), args.simulate) {
            findings.extend(robot.check_driver(extensions, &settings)?);
        }
        let found = findings.into_iter().map(place).collect();
        Ok(Checked { what, values, short_values, warnings, found, ..Checked::default() })
    };
    match Kind::of(source.text()) {
        Some(Kind::Suite) => {
            no_settings()?;
            let suite = Suite::load_allowing(extensions, Files::Disk, path, allow)?;
            let what = format!("a suite of {} runs", suite.runs.len());
            // Its runs are simulations.
            Ok(Checked::of_scenarios(extensions, what, &suite.runs))
        }
        Some(kind @ (Kind::Task | Kind::Experiment)) => {
            if kind == Kind::Experiment {
                refuse_options_of_tasks(path, args)?;
            }
            let ControlArgs { backend, controller } = args.control;
            let options = RunOptions {
                controller,
                transformer: args.transformer.clone(),
                allow: allow.to_vec(),
                ..RunOptions::default()
            };
            let robot = args.robot.as_deref();
            let scenario = Scenario::load(extensions, Files::Disk, path, robot, backend, options, settings)?;
            let Some(experiment) = scenario.single() else {
                let what = format!("an experiment with {} robots", scenario.members.len());
                return Checked::of_scenarios(extensions, what, std::slice::from_ref(&scenario))
                    .with_drivers(extensions, &scenario, args);
            };
            console.detail(&format!("{}: {}", path.display(), experiment.start_text()?));
            let what = format!("a task for the robot '{}'", experiment.robot().name());
            Checked::of_scenarios(extensions, what, std::slice::from_ref(&scenario))
                .with_details(experiment)
                .with_drivers(extensions, &scenario, args)
        }
        Some(Kind::Robot) => robot(),
        // A folder denotes a robot.
        None if path.is_dir() => robot(),
        None => {
            let help = "a robot file has the key `urdf`, a task file `robot` and `priority`, a suite file [[run]], an experiment [robots]";
            let message = "is neither a robot file nor a task file nor a suite file nor an experiment";
            Err(FileError::of_file(source.name(), message, Some(help.to_owned())))
        }
    }
}

/// Lists the values of a robot that are those of the URDF, and those that are assumed.
pub(super) fn values_text(robot: &RobotDefinition) -> String {
    let assumed = &robot.file.assumed;
    let mut text = known_values_text(robot);
    if !assumed.is_empty() {
        text += &format!("  assumed, results rest on them: {}\n", assumed_text(assumed));
    }
    text
}

/// Lists the values of a robot that are those of the URDF, and counts those that are assumed.
fn short_values_text(robot: &RobotDefinition) -> String {
    let assumed = &robot.file.assumed;
    let count =
        if assumed.is_empty() { String::new() } else { line(&format!("{}{LISTED}", assumed_count(assumed))) };
    known_values_text(robot) + &count
}

/// Lists the values of a robot that are those of the URDF.
fn known_values_text(robot: &RobotDefinition) -> String {
    let mount = robot.file.mount.as_ref();
    let mut text = mount.map_or_else(String::new, |mount| format!("  {}\n", mount.description()));
    text += &urdf_values_text(&robot.urdf_values);
    for (link, file) in robot.absent_meshes() {
        text += &format!(
            "  mesh {file} of link '{link}' does not exist: the link has its capsules of robot.toml\n"
        );
    }
    text
}

/// Names of the pairs that are kept apart.
fn kept_pairs(distances: &KeptDistances) -> Vec<[&str; 2]> {
    let geometry = &distances.limits.geometry;
    (0..geometry.pairs().len()).map(|pair| geometry.pair_names(pair)).collect()
}

/// Name of the reason for which a pair is not kept apart.
fn reason_name(reason: DropReason) -> &'static str {
    match reason {
        DropReason::AlwaysColliding => "always-colliding",
        DropReason::NeverNear => "never-near",
        _ => "dropped",
    }
}

/// Number of pairs that are named unless all are asked for.
const NAMED_PAIRS: usize = 5;

/// Describes the pairs that are kept apart, and those that are not; the first ones by name, or `all`.
fn pairs_text(distances: &KeptDistances, all: bool) -> String {
    let list = |pairs: Vec<[&str; 2]>| {
        let named = if all { pairs.len() } else { NAMED_PAIRS };
        let names: Vec<String> = pairs.iter().take(named).map(|[a, b]| format!("{a} and {b}")).collect();
        let others = pairs.len().saturating_sub(named);
        let rest = if others > 0 { format!(", and {others} others (-v names all)") } else { String::new() };
        if names.is_empty() { String::new() } else { format!(": {}{rest}", names.join(", ")) }
    };
    let dropped = |reason: DropReason| -> Vec<[&str; 2]> {
        let pairs = distances.dropped.iter().filter(|pair| pair.reason == reason);
        pairs.map(|pair| [pair.names[0].as_str(), pair.names[1].as_str()]).collect()
    };
    let kept = kept_pairs(distances);
    let (always, never) = (dropped(DropReason::AlwaysColliding), dropped(DropReason::NeverNear));
    format!(
        "  {} pairs are kept {} m apart{}\n  {} pairs always collide and are not kept apart{}\n  {} pairs never meet\n",
        kept.len(),
        distances.limits.margin_m,
        list(kept),
        always.len(),
        list(always),
        never.len()
    )
}

fn thresholds_text(thresholds: &[(String, f64)]) -> String {
    if thresholds.is_empty() {
        return String::new();
    }
    let list: Vec<String> = thresholds.iter().map(|(joint, nm)| format!("{joint} {nm:.2}")).collect();
    format!("  external torques above these are collisions, at rest at the start, Nm: {}\n", list.join(", "))
}

fn force_as_json(force: &DetectableForce) -> Value {
    json!({
        "sensor": force.sensor,
        "at_rest_n": force.at_rest_n,
        "moving_n": force.moving_n,
        "noise_n": force.noise_n,
    })
}

fn pairs_json(distances: &KeptDistances) -> Value {
    let dropped = distances.dropped.iter();
    json!({
        "margin_m": distances.limits.margin_m,
        "kept": kept_pairs(distances),
        "dropped": dropped
            .map(|pair| json!({ "names": pair.names, "reason": reason_name(pair.reason) }))
            .collect::<Vec<Value>>(),
    })
}

fn as_json(path: &Path, checked: &Result<Checked, FileError>) -> Value {
    let told = |found: &Found| {
        json!({
            "code": found.finding.code.name(),
            "at": found.place.path(),
            "line": found.place.line(),
            "key": found.finding.key(),
            "message": found.finding.message,
            "help": found.finding.help,
        })
    };
    match checked {
        Ok(checked) => {
            let [findings, not_checked] =
                [&checked.found, &checked.skipped].map(|list| list.iter().map(told).collect::<Vec<Value>>());
            let margin_of = |servo_loop: ServoLoop| {
                checked.margin.as_ref().filter(|margin| margin.servo_loop == servo_loop).map(|margin| {
                    json!({ "excess": margin.excess, "joint": margin.joint, "transformer": margin.transformer })
                })
            };
            json!({
                "file": path,
                "ok": true,
                "is": checked.what,
                "values": checked.values.lines().map(str::trim).collect::<Vec<&str>>(),
                "position_gain_margin": margin_of(ServoLoop::Position),
                "velocity_gain_margin": margin_of(ServoLoop::Velocity),
                "gears": checked.gears.iter().map(gear_as_json).collect::<Vec<Value>>(),
                "estimated_forces": checked.forces.iter().map(force_as_json).collect::<Vec<Value>>(),
                "collision_thresholds_nm": checked.thresholds.iter().cloned().collect::<BTreeMap<_, _>>(),
                "transformer": checked.strength.as_ref().map(Strength::json),
                "first_at_limit": checked.reserves.iter().map(reserve_as_json).collect::<Vec<Value>>(),
                "singular_postures": checked.singular.iter().map(singular_as_json).collect::<Vec<Value>>(),
                "paths": checked.paths.iter().map(path_as_json).collect::<Vec<Value>>(),
                "kept_distances": checked.distances.as_ref().map(pairs_json),
                "warnings": checked.warnings.iter().map(warning_as_json).collect::<Vec<Value>>(),
                "findings": findings,
                "allowed": checked.allowed,
                "not_checked": not_checked,
            })
        }
        Err(error) => json!({
            "file": path,
            "ok": false,
            "code": error.code().map(Code::name),
            // The mistake may be in a file to which this file refers.
            "at": error.path(),
            "line": error.line(),
            "message": error.message(),
            "help": error.help(),
        }),
    }
}

fn reserve_as_json(reserve: &Reserve) -> Value {
    let frame = match &reserve.of {
        ReserveOf::Payload(frame) => Some(frame),
        _ => None,
    };
    json!({ "of": reserve.of.name(), "frame": frame, "joint": reserve.joint, "at": reserve.at })
}

fn warning_as_json(warning: &Warning) -> Value {
    json!({ "code": warning.code, "at": warning.file, "message": warning.text })
}

fn gear_as_json(gear: &GearResonance) -> Value {
    json!({
        "joint": gear.joint,
        "stiffness_nm_per_rad": gear.stiffness_nm_per_rad,
        "antiresonance_hz": gear.antiresonance_hz,
        "resonance_hz": gear.resonance_hz,
    })
}

fn path_as_json(path: &PathDuration) -> Value {
    json!({
        "task": path.task,
        "length_m": path.length_m,
        "duration_s": path.duration_s,
        "has_approach": path.has_approach,
        "time_optimal": path.time_optimal,
    })
}

fn singular_as_json(postures: &SingularPostures) -> Value {
    json!({
        "task": postures.task,
        "singular": postures.singular,
        "sampled": postures.sampled,
        "fraction": postures.singular as f64 / postures.sampled as f64,
    })
}
