//! The guide: each command and each file in its pages, and in the README, is run.
//!
//! A page is executed from top to bottom in a folder that looks like a clone of the project:
//!
//! * A `toml` block that begins with `# NAME.toml` is a file of this name, or an excerpt of the file if the project has it. Any other block with keys of a task file is an
//!   excerpt: it replaces the same keys in the last file of the page that has a `robot`, and runs for a moment. An excerpt of
//!   another file may only have keys that the schemas know.
//! * A `console` block has commands after `$ `; the lines below a command are part of its output, except `…`. A comment
//!   `# exit code N` states an exit code other than 0. A command that shows a view is ended when it says where its page is. No other
//!   kind of block has commands.
//! * A `rust` block that begins with `// PATH` is an excerpt of this file, which `.ci/run` compiles and runs. `…` in a comment stands
//!   for lines that are left out.
//! * An `xml` block is the file that the comment in its first line names.
//!
//! Commands with MuJoCo say that they are skipped if it is not installed; the step mujoco of `.ci/run` has it.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]
#![expect(clippy::print_stdout, reason = "a test that says that a command is skipped")]

mod excerpts;
mod inline;
mod links;
mod pages;
mod reference;

use crate::cli_common::{ROOT, project, read, scratch};
use pages::{Block, Command, blocks, commands, file_name};
use std::fs;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Output, Stdio};

/// Pages whose commands and files are run, each by the test of the same name.
macro_rules! pages {
    ($($test:ident: $page:literal),* $(,)?) => {
        const PAGES: &[&str] = &[$($page),*];
        $(#[test]
        fn $test() {
            run_page($page);
        })*
    };
}

pages! {
    readme: "README.md",
    install: "docs/start/install.md",
    first_run: "docs/start/first-run.md",
    robot_of_your_own: "docs/start/own-robot.md",
    task_of_your_own: "docs/start/own-task.md",
    references: "docs/howto/references.md",
    tuning: "docs/howto/tuning.md",
    transformer: "docs/explain/transformer.md",
    reading_the_report: "docs/howto/reading-the-report.md",
    troubleshooting: "docs/start/troubleshooting.md",
    cookbook: "docs/start/cookbook.md",
    writing_a_backend: "docs/howto/writing-a-backend.md",
    writing_a_task: "docs/howto/writing-a-task.md",
    control_law: "docs/explain/control-law.md",
    force_control: "docs/explain/force.md",
    real_robot: "docs/explain/real-robot.md",
    environment: "docs/howto/environment.md",
    rust: "docs/howto/rust.md",
    logs: "docs/howto/logs.md",
    so101: "docs/howto/so101.md",
    describe_a_robot: "docs/howto/robot-file.md",
    mujoco: "docs/howto/mujoco.md",
    identification: "docs/howto/identification.md",
    suites: "docs/howto/suites.md",
    live_view: "docs/howto/live-view.md",
    python: "docs/howto/python.md",
    ros2: "docs/howto/ros2.md",
    writing_a_metric: "docs/howto/writing-a-metric.md",
    several_robots: "docs/explain/several-robots.md",
    real_time: "docs/howto/real-time.md",
    results_of_the_paper: "docs/results/paper.md",
    results_of_real_arms: "docs/results/real-arms.md",
}

/// Commands that make the files which a page takes for granted.
const PREPARATIONS: [(&str, &str); 4] = [
    (
        "docs/howto/logs.md",
        "opspace run tasks/compliant-x.toml --duration-s 2 --quiet && mkdir a b && log=runs/compliant-x-asimo-arm-position/run.mcap \
         && for name in run a/run b/run broken; do cp $log $name.mcap; done",
    ),
    ("docs/howto/live-view.md", "opspace run tasks/compliant-x.toml --duration-s 2 --quiet"),
    ("docs/howto/robot-file.md", "cp robots/ur5e/ur5e.urdf ur5e.urdf"),
    ("docs/howto/ros2.md", "cp robots/ur5e/ur5e.urdf arm.urdf"),
];

/// Options with which a command takes less time here. `…` at the end of a command stands for any rest.
const SHORTENED: [(&str, &str); 4] = [
    ("opspace bench examples/so101/suite.toml…", "--shard 1/100"),
    ("opspace bench tasks/suites/limits.toml --csv …", "--shard 1/14"),
    ("opspace bench tasks/suites/limits.toml --plants …", "--shard 1/14"),
    ("opspace bench tasks/suites/elastic-gears.toml --plants …", "--shard 1/30"),
];

/// Pages without commands, whose files are compared with the schemas.
const KEYS_ONLY: [&str; 4] = [
    "docs/reference/metrics.md",
    "docs/reference/transformers.md",
    "docs/results/force.md",
    "docs/results/limitations.md",
];

/// Commands that no test of these pages runs, with the reason. `…` at the end of a command stands for any rest.
const NOT_RUN: &[(&str, &str)] = &[
    ("cargo test", "this is a part of it"),
    (".ci/run…", "this is a part of it"),
    ("OPSPACE_WRITE_API=1 cargo test…", "writes into the project"),
    ("OPSPACE_WRITE_DOCS=1 cargo test…", "writes into the project"),
    ("cargo install --path crates/opspace-cli", "installs a program"),
    ("pip install …", "installs packages; a step of .ci/run does it"),
    ("opspace bench", "takes minutes; the step acceptance of .ci/run runs it"),
    ("opspace bench --json bench.json", "takes minutes; the step acceptance of .ci/run runs it"),
    ("python3 docs/results/medians.py bench.json", "needs Python; the step acceptance of .ci/run runs it"),
    ("opspace bench tasks/suites/teleop.toml", "takes minutes; the step acceptance of .ci/run runs it"),
    ("opspace identify robots/asimo-arm", "takes a minute; the step acceptance of .ci/run runs it"),
    ("opspace identify robots/my-arm …", "a robot of the reader"),
    ("opspace run tasks/my-task.toml …", "a task of the reader"),
    ("opspace doctor", "examines this machine; the tests of opspace-setup examine made-up ones"),
    ("opspace driver …", "needs servos; servo_bus.rs has simulated ones"),
    (
        "opspace run examples/so101/gravity-compensation.toml --robot my-so101 --move-to-start",
        "needs the arm",
    ),
    ("opspace identify my-so101", "needs the arm; servo_bus.rs identifies one behind a simulated bus"),
    (
        "cargo run -p opspace-feetech --example simulated-bus…",
        "serves until it is ended; the step feetech of .ci/run",
    ),
    ("cargo build --release -p opspace-ros2", "a program of its own; the step ros2 of .ci/run builds it"),
    (
        "target/release/opspace-ros2 …",
        "needs robots behind ROS 2; the step ros2 of .ci/run has simulated ones",
    ),
    ("alias opspace=…", "the program of ROS 2"),
    ("opspace description …", "needs robots behind ROS 2"),
    ("opspace run task.toml", "needs robots behind ROS 2"),
    ("ros2 …", "needs ROS 2"),
];

/// True if a pattern stands for a command.
fn stands_for(pattern: &str, command: &str) -> bool {
    pattern.strip_suffix('…').map_or(pattern == command, |begin| command.starts_with(begin))
}

/// Command as it is run here: with the program of this build.
fn with_program(command: &str) -> String {
    command.replace("cargo run --release -- ", "opspace ")
}

/// Pages below `docs`, as paths in the project, in order.
pub fn docs() -> Vec<String> {
    let (mut folders, mut pages) = (vec!["docs".to_owned()], Vec::new());
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(project(&folder)).unwrap() {
            let path = format!("{folder}/{}", entry.unwrap().file_name().into_string().unwrap());
            if Path::new(&project(&path)).is_dir() {
                folders.push(path);
            } else if path.ends_with(".md") {
                pages.push(path);
            }
        }
    }
    pages.sort();
    pages
}

/// Creates a folder that looks like a clone.
fn clone() -> tempfile::TempDir {
    let folder = scratch();
    for name in ["crates", "docs", "examples", "robots", "tasks", "tests"] {
        symlink(project(name), folder.path().join(name)).unwrap();
    }
    folder
}

fn run_page(page: &str) {
    let folder = clone();
    let mut task = None;
    for (_, text) in PREPARATIONS.iter().filter(|(of, _)| *of == page) {
        run(folder.path(), &Command { text: (*text).to_owned(), output: Vec::new(), exit: 0 }, page);
    }
    for block in blocks(&read(project(page))) {
        let place = format!("{page}:{}", block.line);
        match block.language.as_str() {
            "toml" => match file_name(&block, "# ") {
                Some(name) if Path::new(&project(&name)).exists() => check_source(&block, "# ", &place),
                Some(name) => {
                    write(folder.path(), &name, &block.text, &place);
                    task = Some(block.text).filter(|text| text.contains("\nrobot = ")).or(task);
                }
                None => excerpts::check(folder.path(), task.as_deref(), &block.text, &place),
            },
            "console" => {
                for command in commands(&block) {
                    run(folder.path(), &command, &place);
                }
            }
            "rust" => check_source(&block, "// ", &place),
            "xml" => {
                let name = block
                    .text
                    .lines()
                    .next()
                    .and_then(|line| line.strip_prefix("<!-- ")?.strip_suffix(" -->"));
                let name = name.unwrap_or_else(|| panic!("{place}: the first line names no file"));
                write(folder.path(), name, &block.text, &place);
            }
            _ => {}
        }
    }
}

/// Writes a file of a page; never into a folder of the project.
fn write(folder: &Path, name: &str, text: &str, place: &str) {
    let path = folder.join(name);
    let parent = path.parent().unwrap();
    assert!(!name.starts_with('/') && !name.contains(".."), "{place}: {name}");
    fs::create_dir_all(parent).unwrap();
    let inside = parent.canonicalize().unwrap().starts_with(folder.canonicalize().unwrap());
    assert!(inside, "{place}: {name} would be written into the project");
    fs::write(path, text).unwrap();
}

/// Runs a command, and compares its output and exit code with those of the page.
fn run(folder: &Path, command: &Command, place: &str) {
    let text = with_program(&command.text);
    let example = ["cargo run --release -p opspace --example ", "cargo run -p opspace-cli --example "];
    if let Some(example) = example.iter().find_map(|begin| text.strip_prefix(begin)) {
        return assert_example(example, place);
    }
    if NOT_RUN.iter().any(|(not_run, _)| stands_for(not_run, &text)) {
        return;
    }
    if text.contains(" --view") || text.starts_with("opspace view ") {
        return show(folder, &text, place);
    }
    let shortened = SHORTENED.iter().find(|(pattern, _)| stands_for(pattern, &text));
    let text = shortened.map_or(text.clone(), |(_, options)| format!("{text} {options}"));
    let output = in_shell(folder, &text);
    let shown =
        String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(!shown.contains("panicked"), "{place}: {text}:\n{shown}");
    if text.contains("mujoco") && shown.contains("MuJoCo is not installed") {
        assert!(std::env::var_os("OPSPACE_MUJOCO").is_none(), "{place}: {text}: MuJoCo was stated:\n{shown}");
        println!("SKIPPED, {place}: {text}: MuJoCo is not installed");
        return;
    }
    assert_eq!(output.status.code(), Some(command.exit), "{place}: {text}:\n{shown}");
    if command.exit == 0 && names_no_backend(&text) {
        let text = format!("{text} --backend torque --out runs/other-backend --force --quiet");
        let other = Command { text, output: Vec::new(), exit: 0 };
        run(folder, &other, place);
    }
    let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let shown_words = words(&shown);
    for line in &command.output {
        assert!(shown_words.contains(&words(line)), "{place}: {text}: no line `{line}`:\n{shown}");
    }
}

/// Runs a command in a folder by the shell, with the program of this build.
fn in_shell(folder: &Path, text: &str) -> Output {
    let programs = Path::new(env!("CARGO_BIN_EXE_opspace")).parent().unwrap();
    let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
    let mut shell = std::process::Command::new("sh");
    shell.args(["-c", text]).env("PATH", path).env("NO_COLOR", "1").current_dir(folder).stdin(Stdio::null());
    shell.output().unwrap()
}

/// Starts a command that shows a view, at a free port, and ends it as Ctrl-C does when it says where its page is.
fn show(folder: &Path, text: &str, place: &str) {
    let text = if text.contains(" --view") {
        text.replace(" --view", " --view=0")
    } else {
        format!("{text} --at 0")
    };
    let arguments: Vec<&str> = text.split_whitespace().skip(1).collect();
    let mut program = crate::cli_common::command(folder, &arguments)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(program.stderr.take().unwrap()).lines();
    let page = lines.find(|line| line.as_ref().unwrap().starts_with("view at http://127.0.0.1:"));
    let ended =
        std::process::Command::new("kill").args(["-INT", &program.id().to_string()]).status().unwrap();
    lines.for_each(drop);
    let exit = program.wait().unwrap();
    assert!(page.is_some() && ended.success(), "{place}: {text}: no page; {exit}");
}

/// True if a command is one run of a task on the backend of its robot: a position robot. It is run as a torque robot as well.
fn names_no_backend(text: &str) -> bool {
    let of_position_robots = [
        "--backend",
        "--controller",
        "--transformer",
        "--help",
        "--out",
        "--quiet",
        "&&",
        "|",
        "tasks/experiments/",
    ];
    text.starts_with("opspace run ") && !of_position_robots.iter().any(|other| text.contains(other))
}

/// Checks that `.ci/run` runs an example.
fn assert_example(name: &str, place: &str) {
    let name = name.split_whitespace().next().unwrap();
    let listed = read(project(".ci/run")).lines().any(|line| {
        line.contains(&format!("/debug/examples/{name}\""))
            || line.trim().strip_prefix("for example in ").is_some_and(|list| {
                list.trim_end_matches("; do").split_whitespace().any(|example| example == name)
            })
    });
    assert!(listed, "{place}: example {name} is not among those of .ci/run");
}

/// Checks that a block is an excerpt of the file of the project that its first line names.
fn check_source(block: &Block, comment: &str, place: &str) {
    let name = file_name(block, comment).unwrap_or_else(|| panic!("{place}: the first line names no file"));
    let squeezed =
        |text: &str| text.lines().map(str::trim).filter(|l| !l.is_empty()).collect::<Vec<_>>().join("\n");
    let source = squeezed(&read(project(&name)));
    let excerpt = block.text.lines().skip(1).collect::<Vec<_>>().join("\n");
    for part in excerpt.split(&format!("{comment}…")).map(squeezed).filter(|part| !part.is_empty()) {
        assert!(source.contains(&part), "{place}: not in {name}:\n{part}");
    }
}

/// Every page is in the book, and every page with commands is run.
#[test]
fn every_page_is_run_and_in_the_book() {
    let summary = read(project("docs/SUMMARY.md"));
    let mut count = 0;
    for page in docs() {
        let name = page.strip_prefix("docs/").unwrap();
        if name == "SUMMARY.md" {
            continue;
        }
        assert!(summary.contains(&format!("({name})")), "{page} is not in docs/SUMMARY.md");
        let has_commands = blocks(&read(project(&page))).iter().any(|block| block.language == "console");
        assert!(PAGES.contains(&page.as_str()) || !has_commands, "{page} has commands that no test runs");
        count += 1;
    }
    assert!(count > 20, "{count} pages");
}

/// Commands are in `console` blocks, and each is run or is one of `NOT_RUN`, of which all are on a page.
#[test]
fn every_command_is_run_or_has_a_reason() {
    let crates = fs::read_dir(project("crates"))
        .unwrap()
        .map(|entry| format!("crates/{}/README.md", entry.unwrap().file_name().into_string().unwrap()));
    let further = ["README.md", "CONTRIBUTING.md", "python/README.md", "ros2/README.md"].map(str::to_owned);
    let mut unused: Vec<&str> = NOT_RUN.iter().map(|(pattern, _)| *pattern).collect();
    for page in docs().into_iter().chain(further).chain(crates) {
        if !Path::new(&project(&page)).exists() {
            continue;
        }
        for block in blocks(&read(project(&page))) {
            let place = format!("{page}:{}", block.line);
            let language = block.language.as_str();
            let kinds = ["console", "text", "toml", "rust", "python", "xml"];
            assert!(kinds.contains(&language), "{place}: a block of the kind `{language}`");
            if language == "text" {
                let is_command = |line: &str| {
                    ["$ ", "opspace ", "cargo ", "pip ", "ros2 "].iter().any(|b| line.starts_with(b))
                };
                let command = block.text.lines().find(|line| is_command(line));
                assert!(command.is_none(), "{place}: a command in a block of the kind `text`: {command:?}");
            }
            for command in commands(&block).iter().filter(|_| language == "console") {
                let text = with_program(&command.text);
                let is_not_run = NOT_RUN.iter().any(|(pattern, _)| stands_for(pattern, &text));
                assert!(is_not_run || PAGES.contains(&page.as_str()), "{place}: no test runs `{text}`");
                unused.retain(|pattern| !stands_for(pattern, &text));
            }
        }
    }
    assert_eq!(unused, [""; 0], "no page has these commands");
}

/// Excerpts of files in the pages that are not run have only keys that exist.
#[test]
fn excerpts_of_reference_pages_have_known_keys() {
    for page in KEYS_ONLY {
        for block in blocks(&read(project(page))).iter().filter(|block| block.language == "toml") {
            excerpts::assert_known_keys(&block.text, &format!("{page}:{}", block.line));
        }
    }
}

/// Compared: the committed pages of all keys, and the current output of the program. `OPSPACE_WRITE_DOCS=1` writes them.
#[test]
fn key_pages_match_the_program() {
    for kind in ["task", "robot", "suite", "experiment"] {
        let shown =
            crate::cli_common::opspace(Path::new(ROOT), &["schema", kind, "--markdown"]).exits(0).stdout;
        assert_page(&format!("docs/reference/keys-{kind}.md"), &shown);
    }
}

/// Compares a committed page with the one that the program generates, or writes it.
fn assert_page(page: &str, generated: &str) {
    if std::env::var_os("OPSPACE_WRITE_DOCS").is_some() {
        fs::write(project(page), generated).unwrap();
    }
    assert!(generated == read(project(page)), "{page} is out of date: OPSPACE_WRITE_DOCS=1 writes it");
}

/// Compared: every key of a schema, and the keys of its page.
#[test]
fn key_pages_have_every_key() {
    for (kind, schema) in [
        ("task", "tasks/task.schema.json"),
        ("robot", "robots/robot.schema.json"),
        ("suite", "tasks/suite.schema.json"),
        ("experiment", "tasks/experiments/experiment.schema.json"),
    ] {
        let page = read(project(&format!("docs/reference/keys-{kind}.md")));
        let keys = excerpts::all_keys(&crate::cli_common::read_json(project(schema)));
        assert!(keys.len() > 10, "{kind}: {} keys", keys.len());
        for key in keys {
            assert!(page.contains(&format!("`{key}`")), "{kind}: no key `{key}`");
        }
    }
}

/// A task of the cookbook, and settings that break what it shows: then it misses one of its expectations.
const BROKEN: [(&str, &[&str]); 12] = [
    (
        "tasks/draw-letter.toml",
        &[
            "task.draw.cartesian.force.sensed_compensation={ x = 0.0, y = 0.0 }",
            "friction_compensation={ gain = 0.8 }",
            "environment.paper.wall.friction.coefficient=0.9",
        ],
    ),
    (
        "tasks/wipe-table.toml",
        &[
            "task.hand.cartesian.force.gain=0",
            "task.hand.cartesian.force.integral_per_s=0",
            "friction_compensation={ gain = 0.8 }",
        ],
    ),
    (
        "tasks/cookbook/press.toml",
        &[
            "task.hand.cartesian.force.gain=0",
            "task.hand.cartesian.force.integral_per_s=0",
            "friction_compensation={ gain = 0.8 }",
        ],
    ),
    ("tasks/cookbook/hand-guide.toml", &["obstacle.table.half-space.point_m=[0.0, 0.0, 0.0]"]),
    ("tasks/cookbook/carry-level.toml", &["task.level.cartesian.gains.frequency_rad_per_s=2"]),
    ("tasks/ur5e-recorded.toml", &["task.flange.cartesian.gains.frequency_rad_per_s=5"]),
    ("tasks/cookbook/repeat.toml", &["friction_compensation={ gain = 0.0 }"]),
    ("tasks/cookbook/hold-against-pushes.toml", &["task.flange.cartesian.impedance.stiffness_n_per_m=2000"]),
    ("tasks/panda-swivel.toml", &["task.elbow.swivel.gains.frequency_rad_per_s=3"]),
    // It ends before the hand has wiped the whole area, and before it has retracted.
    ("tasks/wipe-table.toml", &["duration_s=4.0"]),
    ("tasks/cookbook/approach-retract.toml", &["duration_s=4.5"]),
    ("tasks/cookbook/approach-retract.toml", &["environment.part.wall.point_m=[0.36, 0.0, -0.6]"]),
];

#[test]
fn cookbook_expectations_fail_when_a_behaviour_breaks() {
    let folder = scratch();
    for (task, settings) in BROKEN {
        let mut arguments = vec!["run", "--out", "broken", "--force", "--quiet"];
        let task = project(task);
        arguments.push(&task);
        for setting in settings {
            arguments.extend(["--set", setting]);
        }
        let ran = crate::cli_common::opspace(folder.path(), &arguments).exits(1);
        assert!(ran.stdout.contains("expectation missed"), "{task}: {}", ran.stdout);
    }
}
