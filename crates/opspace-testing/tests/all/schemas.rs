//! Schemas of files, and the readers of these files, agree on what is allowed.

mod changes;
mod reader_only;
mod schema_file;

use changes::Changes;
use opspace_backend::CommandKind;
use opspace_control::TaskParameters;
use opspace_coupling::CoupledParameters;
use opspace_experiment::files::experiment_file::ExperimentFile;
use opspace_experiment::files::source::parse;
use opspace_experiment::files::task::TaskFile;
use opspace_experiment::transformers::check_robot;
use opspace_experiment::{
    ControllerKind, Experiment, Extensions, FileError, Files, RobotDefinition, RunOptions, Scenario, Source,
    TaskDefinition,
};
use opspace_suite::Suite;
use opspace_suite::suite::SuiteFile;
use reader_only::READER_ONLY;
use schema_file::{SchemaFile, is_nullable};
use std::collections::BTreeSet;
use std::fmt::Debug;
use std::fs;
use std::path::{Path, PathBuf};
use std::thread;
use toml::Table;

/// Fewest changes that the files of the repository allow: fewer would mean that files are not found.
const FEWEST_CHANGES: usize = 30_000;

/// Kinds of files: the schema, and the folder of the files.
const ROBOTS: (&str, &str) = ("robots/robot.schema.json", "robots");
const TASKS: (&str, &str) = ("tasks/task.schema.json", "tasks");
const SUITES: (&str, &str) = ("tasks/suite.schema.json", "tasks/suites");
const EXPERIMENTS: (&str, &str) = ("tasks/experiments/experiment.schema.json", "tasks/experiments");

/// Tables that no robot of the repository needs.
const TABLES_OF_NO_ROBOT: &str = r"
[mount]
xyz_m = [0.1, 0.2, 0.3]
rpy_rad = [0.1, 0.2, 0.3]

[link.link7]
mass_kg = 0.7
com_m = [0.01, 0.02, 0.03]
inertia_kg_m2 = [0.01, 0.0, 0.0, 0.01, 0.0, 0.01]
";

/// Compared: the verdicts of schema and reader about each file of the repository with one key changed: to another sign,
/// size, text or type, to a bound of its range, or beyond it; removed, or added. Compared as well: a file in which a key has
/// its default, and the file without this key.
#[test]
#[ignore = "takes some minutes: .ci/run"]
fn schemas_and_readers_agree() {
    let comparison = thread::scope(|scope| {
        let others = scope.spawn(|| robots().and(suites()).and(experiments()));
        tasks().and(others.join().expect("no panic"))
    });
    let found = &comparison.disagreements;
    assert!(found.is_empty(), "{} of {}:\n{}", found.len(), comparison.changes, found.join("\n"));
    let rules = READER_ONLY.iter().flat_map(|(_, rules)| rules.iter()).copied();
    let unused: Vec<&str> = rules.filter(|rule| !comparison.rules.contains(rule)).collect();
    assert!(unused.is_empty(), "rules that no change breaks: {unused:?}");
    assert!(comparison.changes > FEWEST_CHANGES, "only {} changes", comparison.changes);
}

/// Result of a comparison.
#[derive(Default)]
struct Comparison {
    changes: usize,
    disagreements: Vec<String>,
    /// Rules of [`READER_ONLY`] that changes break.
    rules: BTreeSet<&'static str>,
}

impl Comparison {
    fn and(mut self, other: Self) -> Self {
        self.changes += other.changes;
        self.disagreements.extend(other.disagreements);
        self.rules.extend(other.rules);
        self
    }

    /// Compares schema and reader on the changes of a file. The reader returns the contents that it has read.
    fn add(
        &mut self,
        source: &Source,
        schema: &SchemaFile,
        changes: &mut Changes<'_>,
        read: impl Fn(Source, bool) -> Result<String, String>,
    ) {
        let file: Table = source.text().parse().expect("TOML");
        let read_changed = |file: &Table, is_allowed: bool| {
            read(Source::new(source.name(), toml::to_string(file).expect("TOML")), is_allowed)
        };
        let contents = read_changed(&file, true).unwrap_or_else(|error| panic!("{}: {error}", source.name()));
        let all = changes.of(&file);
        self.changes += all.len();
        for change in all {
            let changed = change.apply(&file);
            let is_allowed = schema.accepts(&changed);
            let found = match read_changed(&changed, is_allowed) {
                Ok(read) if is_allowed && change.is_default && read != contents => {
                    "is not the default".to_owned()
                }
                Ok(_) if is_allowed => continue,
                Ok(_) => "only the schema refuses it".to_owned(),
                Err(_) if !is_allowed => continue,
                Err(message) => {
                    let rules = READER_ONLY.iter().flat_map(|(_, rules)| rules.iter());
                    let broken: Vec<&str> = rules.copied().filter(|rule| message.contains(rule)).collect();
                    self.rules.extend(&broken);
                    if !broken.is_empty() {
                        continue;
                    }
                    format!("only the reader refuses it: {message}")
                }
            };
            self.disagreements.push(format!("{}: {}: {found}", source.name(), change.describe()));
        }
    }
}

fn robots() -> Comparison {
    let extensions = Extensions::default();
    let mut comparison = Comparison::default();
    let schema = SchemaFile::read(&root(ROBOTS.0));
    let mut changes = Changes::new(&schema);
    let load = |path: &Path| RobotDefinition::load(Files::Disk, path, &[]).expect("a robot");
    let mut robots: Vec<RobotDefinition> = files(ROBOTS).iter().map(|path| load(path)).collect();
    let panda = load(&root("robots/panda/robot.toml"));
    let source = Source::new("a mounted panda", format!("{}{TABLES_OF_NO_ROBOT}", panda.source.text()));
    robots.push(RobotDefinition::from_sources(source, panda.urdf).expect("a robot"));
    for robot in robots {
        comparison.add(&robot.source, &schema, &mut changes, |source, _| {
            let robot = RobotDefinition::from_sources(source, robot.urdf.clone());
            let known = robot.and_then(|robot| check_robot(&extensions, &robot).map(|()| robot));
            known.map(|robot| contents(&robot.file)).map_err(|error| message(&error))
        });
    }
    comparison
}

fn tasks() -> Comparison {
    let extensions = Extensions::default().with_comparisons();
    let mut comparison = Comparison::default();
    let schema = SchemaFile::read(&root(TASKS.0));
    let mut changes = Changes::new(&schema);
    for path in files(TASKS) {
        let task = TaskDefinition::load_with(&extensions, Files::Disk, &path, &[]).expect("a task");
        let robot = RobotDefinition::load(Files::Disk, &task.robot_path(), &[]).expect("a robot");
        let experiment =
            |task, options: &RunOptions| Experiment::new(robot.clone(), task, options.clone(), Vec::new());
        let options = options().find(|options| experiment(task.clone(), options).is_ok());
        let options = options.unwrap_or_else(|| panic!("{}", path.display()));
        comparison.add(&task.source, &schema, &mut changes, |source, _| {
            let file = parse::<TaskFile>(&without_coupled(&source)).map_err(|error| message(&error))?;
            let then = |error: FileError| format!("then {}", message(&error));
            let task =
                TaskDefinition::from_sources_with(&extensions, source, |named| Source::read(named.path))
                    .map_err(then)?;
            let contents = contents(&(file, coupled_parameters(&task.file)));
            experiment(task, &options).map(|_| contents).map_err(then)
        });
    }
    comparison
}

/// Robots and controllers that do all tasks.
fn options() -> impl Iterator<Item = RunOptions> {
    let kinds = [
        (CommandKind::Position, ControllerKind::Osc),
        (CommandKind::Torque, ControllerKind::Osc),
        (CommandKind::Position, ControllerKind::Ik),
    ];
    kinds.into_iter().map(|(backend, controller)| RunOptions { backend, controller, ..RunOptions::default() })
}

/// The experiments of a suite are only read if its schema refuses the change: that takes long.
fn suites() -> Comparison {
    compare_with_copies(SUITES, |source, is_allowed, copy| {
        let file = parse::<SuiteFile>(source)?;
        if !is_allowed {
            Suite::load_with(&Extensions::default().with_comparisons(), Files::Disk, copy)?;
        }
        Ok(contents(&file))
    })
}

fn experiments() -> Comparison {
    compare_with_copies(EXPERIMENTS, |source, _, copy| {
        let file = parse::<ExperimentFile>(source)?;
        Scenario::load_robots(&Extensions::default(), Files::Disk, copy, &[], &[]).map(|_| contents(&file))
    })
}

/// Compares files that refer to others by relative paths: `read` also gets the path of a copy.
fn compare_with_copies(
    kind: (&str, &str),
    read: impl Fn(&Source, bool, &Path) -> Result<String, FileError>,
) -> Comparison {
    let mut comparison = Comparison::default();
    let schema = SchemaFile::read(&root(kind.0));
    let mut changes = Changes::new(&schema);
    let folder = tempfile::tempdir().expect("a folder");
    let copy = folder.path().join("copy.toml");
    for path in files(kind) {
        let own = path.parent().expect("a folder").display().to_string();
        let source = Source::read(&path).expect("a file");
        comparison.add(&source, &schema, &mut changes, |source, is_allowed| {
            fs::write(&copy, source.text().replace("\"../", &format!("\"{own}/../"))).expect("a copy");
            read(&source, is_allowed, &copy).map_err(|error| message(&error))
        });
    }
    comparison
}

/// Compared: the first line of each file of the repository, by which editors find its schema, and the schema that accepts it.
#[test]
fn files_name_the_schema_that_accepts_them() {
    for kind in [ROBOTS, TASKS, SUITES, EXPERIMENTS] {
        let schema = SchemaFile::read(&root(kind.0));
        for path in files(kind) {
            let text = fs::read_to_string(&path).expect("a file");
            let named =
                text.lines().next().and_then(|line| line.strip_prefix("#:schema ")).expect("a schema");
            let named = path.with_file_name(named).canonicalize().expect("a schema");
            assert_eq!(named, root(kind.0).canonicalize().expect("a schema"), "{}", path.display());
            assert!(schema.accepts(&text.parse().expect("TOML")), "{}", path.display());
        }
    }
}

/// Checks that schemas refuse files with an unknown key, without a required key, or with -1 for values above zero.
#[test]
fn schemas_refuse_wrong_files() {
    let arm = "robots/asimo-arm/robot.toml";
    for ((schema, _), file, change) in [
        (ROBOTS, arm, "interface.no_such_key = 1"),
        (ROBOTS, arm, "urdf = absent"),
        (ROBOTS, arm, "kp_per_s = -1.0"),
        (ROBOTS, arm, "servo_hz = -1.0"),
        (ROBOTS, arm, "gear_ratio = -1.0"),
        (ROBOTS, arm, "velocity_filter_hz = -1.0"),
        (TASKS, "tasks/compliant-x.toml", "priority = absent"),
        (TASKS, "tasks/compliant-x.toml", "duration_s = -1.0"),
        (SUITES, "tasks/suites/paper.toml", "run = absent"),
        (EXPERIMENTS, "tasks/experiments/teleop-wall.toml", "couplings = absent"),
    ] {
        let schema = SchemaFile::read(&root(schema));
        let file: Table = fs::read_to_string(root(file)).expect("a file").parse().expect("TOML");
        let changes = Changes::new(&schema).of(&file);
        let (mut changes, mut count) = (changes.iter().filter(|one| one.describe().ends_with(change)), 0);
        assert!(
            changes.all(|one| {
                count += 1;
                !schema.accepts(&one.apply(&file))
            }),
            "{change}"
        );
        assert!(count > 0, "{change}");
    }
}

/// Checks that each key which may be absent has a default, in figures or in words, or is one that may have no value.
#[test]
fn keys_that_may_be_absent_have_defaults() {
    for (path, _) in [ROBOTS, TASKS, SUITES, EXPERIMENTS] {
        let schema = SchemaFile::read(&root(path));
        let without: Vec<String> = schema
            .optional_keys()
            .filter(|(_, of)| of["default"].is_null() && of["x-default"].is_null() && !is_nullable(of))
            .map(|(name, _)| name)
            .collect();
        assert!(without.is_empty(), "{path}: {without:?}");
    }
}

/// Returns a task file without its coupled tasks, which are of no kind of [`TaskParameters`].
fn without_coupled(source: &Source) -> Source {
    let mut file: Table = source.text().parse().expect("TOML");
    if let Some(tasks) = file.get_mut("task").and_then(toml::Value::as_table_mut) {
        tasks.retain(|_, task| task.get("coupled").is_none());
    }
    Source::new(source.name(), toml::to_string(&file).expect("TOML"))
}

/// Parameters of the coupled tasks of a file.
fn coupled_parameters<'a>(file: &'a TaskFile) -> Vec<&'a CoupledParameters> {
    let of_task = |task: &'a TaskParameters| match task {
        TaskParameters::Registered(task) => task.parameters(),
        _ => None,
    };
    file.task.values().filter_map(of_task).collect()
}

fn contents(file: &impl Debug) -> String {
    format!("{file:?}")
}

fn message(error: &FileError) -> String {
    let code = error.code().map_or_else(String::new, |code| format!(" [{code}]"));
    format!("{}{code}", error.message())
}

fn root(path: &str) -> PathBuf {
    let crates = Path::new(env!("CARGO_MANIFEST_DIR")).parent().and_then(Path::parent);
    crates.expect("the root of the repository").join(path)
}

/// Paths of the files of a kind, sorted: suites and experiments are in folders of the tasks.
fn files((_, folder): (&str, &str)) -> Vec<PathBuf> {
    let mut paths = Vec::new();
    let mut folders = vec![root(folder)];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("a folder of the repository") {
            let path = entry.expect("an entry").path();
            if path.is_dir() && path != root(SUITES.1) && path != root(EXPERIMENTS.1) {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "toml") {
                paths.push(path);
            }
        }
    }
    paths.sort();
    assert!(!paths.is_empty(), "{folder} has no files");
    paths
}
