//! The files of the repository that are changed, in a copy, and the logs and results of short runs.

use crate::edits::{self, Edit};
use crate::program::Program;
use crate::toml_changes;
use bolero::ValueGenerator;
use bolero::generator::bolero_generator::driver::{ByteSliceDriver, Options};
use opspace_testing::random::Random;
use std::fs;
use std::path::{Path, PathBuf};
use toml::Table;

/// Settings for a run of a few cycles.
pub const SHORT: [&str; 2] = ["duration_s=0.05", "settle_s=0"];

/// Length of a suite file from which on it is left out, bytes.
const LONGEST_SUITE: usize = 5000;

/// Number of random bytes of which edits are made.
const BYTES: usize = 512;

/// Everything that the kinds use.
pub struct Inputs {
    pub program: Program,
    /// Copy of robots, tasks and experiments of the repository.
    pub tree: PathBuf,
    pub tasks: Vec<Seed>,
    pub experiments: Vec<Seed>,
    /// Names of the folders of the robots, in the order of their files below.
    pub names: Vec<String>,
    pub robots: Vec<Seed>,
    pub urdfs: Vec<Seed>,
    pub suites: Vec<Seed>,
    /// Logs of short runs.
    pub logs: Vec<(PathBuf, Vec<u8>)>,
    /// Folder of a suite with its results.
    pub results: PathBuf,
}

/// File that is changed.
#[derive(Clone)]
pub struct Seed {
    pub path: PathBuf,
    pub text: String,
}

/// Suite of few short runs; `TASK` is the path of its task.
pub const SUITE: &str = "title = \"Few runs\"\n\n[[run]]\ntasks = [\"TASK\"]\nseeds = [1, 2, 3]\n\
    override = [\"duration_s=0.05\", \"settle_s=0\"]\n\n[[run]]\ntasks = [\"TASK\"]\nlabel = \"slow\"\n\
    override = [\"duration_s=0.06\", \"settle_s=0.01\"]\n";

impl Inputs {
    /// Copies the files, and runs what gives logs and results.
    ///
    /// # Errors
    /// A file that cannot be copied, or a run that fails.
    pub fn new(program: Program, work: &Path) -> Result<Self, String> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let tree = work.join("tree");
        for folder in ["robots", "tasks"] {
            copy(&root.join(folder), &tree.join(folder))?;
        }
        let reaching = tree.join("tasks/planar-2-link-reach.toml");
        let suite = tree.join("tasks/suites/few-runs.toml");
        write(&suite, SUITE.replace("TASK", "../planar-2-link-reach.toml"))?;
        let mut logs = Vec::new();
        drop(fs::remove_dir_all(work.join("results")));
        let names = ["tasks/planar-2-link-reach", "tasks/panda-press", "tasks/experiments/teleop-free"];
        for (number, name) in names.into_iter().enumerate() {
            let (out, file) = (format!("log-{number}"), tree.join(format!("{name}.toml")));
            let [duration, settle] = SHORT;
            let arguments = [
                "run",
                &text(&file),
                "--out",
                &out,
                "--set",
                duration,
                "--set",
                settle,
                "--set",
                "expect={}",
            ];
            let ended = program.run(work, &arguments)?;
            let folder = work.join(&out);
            let folder = if name.starts_with("tasks/experiments") { folder.join("leader") } else { folder };
            let path = folder.join("run.mcap");
            let bytes =
                fs::read(&path).map_err(|error| format!("{}: {error}\n{}", path.display(), ended.said))?;
            logs.push((path, bytes));
        }
        let results = work.join("results");
        fs::create_dir_all(&results).map_err(|error| error.to_string())?;
        write(&results.join("suite.toml"), SUITE.replace("TASK", &text(&reaching)))?;
        let ended = program.run(&results, &["bench", "suite.toml", "--out", "out"])?;
        if ended.code != 0 {
            return Err(format!("the suite of few runs fails: {}", ended.said));
        }
        let toml = |folder: &str| seeds(&tree.join(folder), ".toml");
        // Those with a thousand runs are read for a minute without optimisation.
        let mut suites = toml("tasks/suites")?;
        suites.retain(|suite| suite.text.len() < LONGEST_SUITE);
        let names = robot_names(&tree.join("robots"))?;
        Ok(Self {
            tasks: [toml("tasks")?, toml("tasks/cookbook")?].concat(),
            experiments: toml("tasks/experiments")?,
            robots: of_robots(&tree, &names, |_| "robot.toml".to_owned())?,
            urdfs: of_robots(&tree, &names, |robot| format!("{robot}.urdf"))?,
            names,
            suites,
            program,
            tree,
            logs,
            results,
        })
    }
}

/// Path as text.
pub fn text(path: &Path) -> String {
    path.display().to_string()
}

/// Writes a file.
///
/// # Errors
/// Path and reason.
pub fn write(path: &Path, contents: impl AsRef<[u8]>) -> Result<(), String> {
    fs::write(path, contents).map_err(|error| format!("{}: {error}", path.display()))
}

/// Copies a folder with all that is in it.
///
/// # Errors
/// Path and reason.
pub fn copy(from: &Path, to: &Path) -> Result<(), String> {
    let explain = |error: std::io::Error| format!("{}: {error}", from.display());
    fs::create_dir_all(to).map_err(explain)?;
    for entry in fs::read_dir(from).map_err(explain)? {
        let entry = entry.map_err(explain)?;
        let to = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &to)?;
        } else {
            fs::copy(entry.path(), to).map_err(explain)?;
        }
    }
    Ok(())
}

/// Files of a folder with that ending, sorted by path.
fn seeds(folder: &Path, ending: &str) -> Result<Vec<Seed>, String> {
    let explain = |error: std::io::Error| format!("{}: {error}", folder.display());
    let mut seeds = Vec::new();
    for entry in fs::read_dir(folder).map_err(explain)? {
        let path = entry.map_err(explain)?.path();
        if text(&path).ends_with(ending) {
            seeds.push(Seed { text: fs::read_to_string(&path).map_err(explain)?, path });
        }
    }
    seeds.sort_by(|one, other| one.path.cmp(&other.path));
    Ok(seeds)
}

/// Names of the folders of robots, in alphabetical order.
fn robot_names(folder: &Path) -> Result<Vec<String>, String> {
    let explain = |error: std::io::Error| format!("{}: {error}", folder.display());
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(explain)? {
        let entry = entry.map_err(explain)?;
        if entry.path().join("robot.toml").is_file() {
            names.push(entry.file_name().to_string_lossy().into_owned());
        }
    }
    names.sort();
    Ok(names)
}

fn of_robots(tree: &Path, names: &[String], name: impl Fn(&str) -> String) -> Result<Vec<Seed>, String> {
    let file = |robot: &str| {
        let path = tree.join("robots").join(robot).join(name(robot));
        let text = fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))?;
        Ok(Seed { path, text })
    };
    names.iter().map(|robot| file(robot)).collect()
}

/// Returns a TOML file after one to three changes of its keys and values, or of its text.
pub fn changed_toml(seeds: &[Seed], seed: usize, random: &mut Random) -> Vec<u8> {
    if random.is(0.25) {
        return changed_text(seeds, seed, random);
    }
    let table = |seed: &Seed| seed.text.parse::<Table>().unwrap_or_default();
    let donor = table(&seeds[random.below(seeds.len())]);
    toml_changes::changed(table(&seeds[seed]), &donor, random).into_bytes()
}

/// Returns a text after some edits.
pub fn changed_text(seeds: &[Seed], seed: usize, random: &mut Random) -> Vec<u8> {
    let texts: Vec<&str> = seeds.iter().map(|seed| seed.text.as_str()).collect();
    edits::apply(&texts, seed, &edits(random))
}

/// Draws one to five edits of a text.
fn edits(random: &mut Random) -> Vec<Edit> {
    let bytes: Vec<u8> = (0..BYTES).map(|_| random.below(256) as u8).collect();
    let generated = edits::edited(1).generate(&mut ByteSliceDriver::new(&bytes, &Options::default()));
    generated.map_or_else(Vec::new, |(_, edits)| edits)
}
