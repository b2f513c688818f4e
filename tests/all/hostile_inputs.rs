//! Inputs of a folder that is not trusted: files that are no files, records that claim gigabytes, and programs and
//! libraries beside the user's files.
#![cfg(unix)]
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::cli_common::{circle_folder, command, opspace, project, run, scratch};
use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

const SUITE: &str = "title = \"t\"\n[[run]]\ntasks = [\"circle.toml\"]\n";

/// Time after which a command is taken to wait for a pipe: a refusal takes some hundredths of it.
const LONGEST: Duration = Duration::from_secs(15);

/// Exit code and errors of a command; a command that does not end is a failure.
#[track_caller]
fn ended(folder: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let mut child = command(folder, arguments).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let begun = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if begun.elapsed() > LONGEST {
            child.kill().unwrap();
            child.wait().unwrap();
            panic!("{arguments:?} does not end");
        }
        sleep(Duration::from_millis(10));
    }
    let mut said = String::new();
    child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    (child.wait().unwrap().code(), said)
}

fn make_pipe(path: &Path) {
    assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
}

/// Checks that no command opens a pipe, whatever argument or key of a file names it.
#[test]
fn pipes_are_refused_before_they_are_opened() {
    let folder = circle_folder(SUITE);
    let at = |name: &str| folder.path().join(name);
    make_pipe(&at("pipe"));
    fs::create_dir(at("results")).unwrap();
    make_pipe(&at("results/run.mcap"));
    make_pipe(&at("results/rows.jsonl"));
    let circle = fs::read_to_string(at("circle.toml")).unwrap();
    let robot = project("robots/planar-2-link");
    fs::write(at("of-pipe.toml"), circle.replace(&robot, "pipe")).unwrap();
    let begin = circle.find("reference.").unwrap();
    let recorded = format!("{}reference.recorded = {{ file = \"pipe\" }}\n", &circle[..begin]);
    fs::write(at("recorded.toml"), recorded).unwrap();
    let urdf = project("robots/planar-2-link/planar-2-link.urdf");
    let cases: [&[&str]; 21] = [
        &["check", "pipe"],
        &["check", "of-pipe.toml"],
        &["check", "recorded.toml"],
        &["check", "circle.toml", "--robot", "pipe"],
        &["run", "pipe"],
        &["run", "recorded.toml"],
        &["run", "circle.toml", "--backend", "replay", "--log", "pipe"],
        &["bench", "pipe"],
        &["bench", "suite.toml", "--baseline", "pipe"],
        &["merge", "results"],
        &["replay", "pipe"],
        &["replay", "results"],
        &["report", "pipe"],
        &["report", "results"],
        &["log", "info", "pipe"],
        &["log", "diff", "pipe", "pipe"],
        &["log", "recover", "pipe", "-o", "recovered.mcap"],
        &["model", "pipe"],
        &["model", &urdf, "--tip", "tip", "--samples", "pipe"],
        &["new", "mine", "--urdf", "pipe"],
        &["identify", "pipe"],
    ];
    for arguments in cases {
        let (code, said) = ended(folder.path(), arguments);
        assert_eq!(code, Some(2), "{arguments:?}: {said}");
        assert!(
            said.contains("a pipe, not a regular file") || arguments[0] == "merge",
            "{arguments:?}: {said}"
        );
    }
}

/// Checks that a mesh that is a pipe is named and not opened.
#[test]
fn mesh_that_is_a_pipe_is_refused() {
    let folder = scratch();
    make_pipe(&folder.path().join("link.stl"));
    let urdf = fs::read_to_string(project("robots/planar-2-link/planar-2-link.urdf")).unwrap();
    let collision = "<collision><geometry><mesh filename=\"link.stl\"/></geometry></collision></link>";
    fs::write(folder.path().join("arm.urdf"), urdf.replace("</link>", collision)).unwrap();
    let (code, said) = ended(folder.path(), &["model", "arm.urdf", "--capsules"]);
    assert!(code.is_some_and(|code| code < 3) && said.contains("is not a file"), "{code:?}: {said}");
}

/// Checks that a log needs no memory for what a record claims. The file has a hole of 3 GB, which takes no place on the disk.
#[test]
fn records_that_claim_gigabytes_are_skipped() {
    const CLAIMED: u64 = 3 << 30;
    const MAGIC: usize = 8;
    let folder = scratch();
    let log = fs::read(run(folder.path(), "out", "joint-tracking", &[])).unwrap();
    // Kinds of records: a chunk, an attachment, metadata, and one that no version of the format has.
    for (kind, code) in [(6, 2), (9, 3), (12, 3), (200, 3)] {
        let path = folder.path().join(format!("claims-{kind}.mcap"));
        let mut file = File::create(&path).unwrap();
        file.write_all(&log[..MAGIC]).unwrap();
        file.write_all(&[kind]).unwrap();
        file.write_all(&CLAIMED.to_le_bytes()).unwrap();
        file.seek(SeekFrom::Current(CLAIMED as i64)).unwrap();
        file.write_all(&log[MAGIC..]).unwrap();
        drop(file);
        for name in ["info", "diff"] {
            let other = if name == "diff" { "out" } else { "" };
            // A GB of addresses, of which the program itself takes a part.
            let script = "ulimit -v 1000000; exec \"$1\" log $2 \"$3\" $4";
            let output = Command::new("sh")
                .args(["-c", script, "sh", env!("CARGO_BIN_EXE_opspace"), name])
                .arg(&path)
                .arg(other)
                .current_dir(folder.path())
                .output()
                .unwrap();
            let text = String::from_utf8_lossy(&output.stdout).into_owned();
            let said = text + &String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(code), "kind {kind}, {name}: {said}");
            assert!(said.contains("bytes; at most"), "kind {kind}, {name}: {said}");
            assert!(!said.contains("the logs are equal"), "{said}");
        }
    }
}

/// Writes a program that leaves a file beside it when it is started.
fn spy(folder: &Path, name: &str) {
    let path = folder.join(name);
    fs::write(&path, format!("#!/bin/sh\n: > '{}/started'\n", folder.display())).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
}

/// Checks that no program of the working folder is started, even if the search path has relative folders.
#[test]
fn programs_of_the_working_folder_are_not_started() {
    let folder = circle_folder(SUITE);
    for name in ["python3", "python", "xdg-open", "open", "xacro"] {
        spy(folder.path(), name);
    }
    fs::write(folder.path().join("arm.xacro"), "<robot/>").unwrap();
    for path in [".", "", ":/nowhere:", "./"] {
        for arguments in [
            &["run", "circle.toml", "--plant", "mujoco"][..],
            &["new", "mine", "--urdf", "arm.xacro", "--assume"],
            &["run", "circle.toml", "--out", "out", "--force", "--open"],
        ] {
            command(folder.path(), arguments)
                .env_remove("OPSPACE_MUJOCO")
                .env("PATH", path)
                .output()
                .unwrap();
            assert!(!folder.path().join("started").exists(), "PATH={path:?}: {arguments:?}");
        }
    }
}

/// Checks that a library in the working folder is not opened: not one that Python would find there, and not one to
/// which a Python refers. It can be named.
#[test]
fn libraries_of_the_working_folder_are_not_opened() {
    let folder = circle_folder(SUITE);
    let package = folder.path().join("mujoco");
    fs::create_dir(&package).unwrap();
    fs::write(package.join("__init__.py"), "").unwrap();
    fs::write(package.join("libmujoco.so.9.9.9"), "no library").unwrap();
    let arguments = ["run", "circle.toml", "--plant", "mujoco", "--out", "out"];
    let begin = || {
        let mut command = command(folder.path(), &arguments);
        command.env_remove("OPSPACE_MUJOCO");
        command
    };
    let said = String::from_utf8(begin().output().unwrap().stderr).unwrap();
    assert!(!said.contains("libmujoco.so.9.9.9"), "{said}");

    let bin = scratch();
    let python = bin.path().join("python3");
    fs::write(&python, "#!/bin/sh\necho \"$PWD/mujoco\"\necho /usr\necho /nowhere\n").unwrap();
    fs::set_permissions(&python, fs::Permissions::from_mode(0o755)).unwrap();
    let output = begin().env("PATH", bin.path()).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{said}");
    for words in ["libmujoco.so.9.9.9", "is in the working folder", "set OPSPACE_MUJOCO to this path"] {
        assert!(said.contains(words), "{said}");
    }
    let output = begin().env("OPSPACE_MUJOCO", "mujoco/libmujoco.so.9.9.9").output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("MuJoCo cannot be opened"), "{said}");
}

/// Checks that an error about an argument shows the characters that would colour or reverse a terminal's text as numbers.
#[test]
fn arguments_are_escaped_in_errors() {
    let folder = scratch();
    for arguments in [
        ["run", "--no\u{202e}\u{1b}[31m"],
        ["ru\u{1b}[31m\u{202e}n", "x"],
        ["run", "--plant=\u{1b}]0;x\u{7}"],
    ] {
        let ran = opspace(folder.path(), &arguments).exits(2);
        assert!(!ran.stderr.contains(['\u{1b}', '\u{202e}', '\u{7}']), "{:?}", ran.stderr);
        assert!(ran.stderr.contains("\\u{1b}"), "{}", ran.stderr);
    }
}

/// Checks that a suite removes what a killed process left in its folder, and nothing else.
#[test]
fn leftovers_of_killed_processes_are_removed() {
    let folder = circle_folder(SUITE);
    let results = folder.path().join("results");
    fs::create_dir(&results).unwrap();
    // No process has the first number.
    let dead = format!(".circle.mcap.{}.123456789.0", u32::MAX);
    let alive = format!(".circle.mcap.{}.123456789.0", std::process::id());
    let kept = [alive.as_str(), ".circle.mcap", ".notes.1.2.x", "notes.1.2.3"];
    for name in kept.iter().chain([&dead.as_str()]) {
        fs::write(results.join(name), "x").unwrap();
    }
    opspace(folder.path(), &["bench", "suite.toml", "--out", "results"]).exits(0);
    assert!(!results.join(&dead).exists());
    kept.iter().for_each(|name| assert!(results.join(name).exists(), "{name}"));
}

/// Checks that a page forbids a browser everything but its own styles and scripts.
#[test]
fn pages_load_nothing() {
    let folder = circle_folder(SUITE);
    opspace(folder.path(), &["run", "circle.toml", "--out", "out"]).exits(0);
    let page = fs::read_to_string(folder.path().join("out/report.html")).unwrap();
    let policy = "http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'; img-src blob:; script-src 'sha256-";
    assert!(page.contains(policy) && page.find(policy) < page.find("<style>"));
    // Its scripts save figures and unpack the player; the policy permits them, and the player, by their hashes. The others are data.
    let scripts: Vec<&str> = page.split("<script").skip(1).map(|script| &script[..18]).collect();
    assert_eq!(
        scripts,
        [">/* Saves a figure", " type=\"application", " type=\"application", ">/* Unpacks the pl"]
    );
    assert_eq!(
        page.split("script-src").nth(1).unwrap().split('"').next().unwrap().matches("'sha256-").count(),
        3
    );
    assert!(!page.contains(" onload="));
}

/// A full disk has one exit code, whatever was written to it.
#[cfg(target_os = "linux")]
#[test]
fn full_disk_exits_with_3() {
    let folder = circle_folder(SUITE);
    opspace(folder.path(), &["run", "circle.toml", "--out", "out"]).exits(0);
    let cases: [&[&str]; 5] = [
        &["run", "circle.toml", "--out", "other", "--json", "/dev/full"],
        &["report", "out", "-o", "/dev/full"],
        &["log", "export", "out", "-o", "/dev/full"],
        &["bench", "suite.toml", "--out", "suite", "--csv", "/dev/full"],
        &["check", "circle.toml", "--json", "/dev/full"],
    ];
    for arguments in cases {
        opspace(folder.path(), arguments).exits(3).says(&["/dev/full"]);
    }
    for arguments in [&["check", "circle.toml"][..], &["log", "export", "out", "-o", "-"]] {
        let full = File::options().write(true).open("/dev/full").unwrap();
        let output = command(folder.path(), arguments).stdout(full).output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(3), "{arguments:?}: {said}");
        assert!(said.contains("cannot write to standard output"), "{said}");
    }
}

/// Checks that the work of a check is bounded by what it accepts: rates, durations, events and points beyond a bound are refused
/// with the bound; as many as are accepted are checked.
#[test]
fn work_is_bounded_by_what_is_accepted() {
    let folder = circle_folder(SUITE);
    let at = |name: &str| folder.path().join(name);
    let circle = fs::read_to_string(at("circle.toml")).unwrap();
    let events = |count: usize| {
        let event = |k: usize| {
            let (time_s, ratio) = (0.4 * (k + 1) as f64 / (count + 1) as f64, 0.9 + 0.1 * (k % 2) as f64);
            format!(
                "[[event]]\ntime_s = {time_s:?}\nset = [\"task.tip.cartesian.gains.damping_ratio={ratio}\"]\n"
            )
        };
        format!("{circle}{}", (0..count).map(event).collect::<String>())
    };
    let head = &circle[..circle.find("reference.").unwrap()];
    let spline = |count: usize| {
        let point = |k: usize| format!("[{:?}, 0.0, {:?}]", 2e-4 * (k + 1) as f64, 2e-4 * (k % 2) as f64);
        let points = (0..count).map(point).collect::<Vec<_>>().join(", ");
        format!(
            "{head}[task.tip.cartesian.reference.path]\nspeed_m_per_s = 0.3\nacceleration_m_per_s2 = 2.0\n\
             jerk_m_per_s3 = 20.0\nsegments = [{{ spline = {{ through_m = [{points}] }} }}]\n"
        )
    };
    fs::write(at("many.toml"), events(1001)).unwrap();
    opspace(folder.path(), &["check", "many.toml"]).exits(2).says(&["1001 events; at most 1000"]);
    fs::write(at("long.toml"), spline(2001)).unwrap();
    opspace(folder.path(), &["check", "long.toml"]).exits(2).says(&["2001 points", "at most 2000"]);
    fs::write(at("events.toml"), events(80)).unwrap();
    opspace(folder.path(), &["check", "events.toml"]).exits(0);
    fs::write(at("spline.toml"), spline(100)).unwrap();
    opspace(folder.path(), &["check", "spline.toml"]).exits(0);
    let rate = ["check", "circle.toml", "--set", "robot.profile.default.servo_hz=1e6"];
    opspace(folder.path(), &rate)
        .exits(2)
        .says(&["1e6 Hz is not from 1e-3 to 5e4 Hz", "not that of its current loop"]);
    let forever = ["check", "circle.toml", "--set", "duration_s=1e12"];
    opspace(folder.path(), &forever).exits(2).says(&[
        "duration_s",
        "1e6 s (12 days)",
        "its log would have about 5e8 GB",
    ]);
    let day = ["check", "circle.toml", "--set", "duration_s=86400"];
    opspace(folder.path(), &day).exits(0).prints(&["the log of 86400 s will have about 43 GB"]);
}

/// Checks that a robot file that a simulation refuses is refused without a task, at the same place.
#[test]
fn robot_that_cannot_be_simulated_is_refused_without_a_task() {
    let folder = scratch();
    let text = fs::read_to_string(project("robots/planar-2-link/robot.toml")).unwrap();
    fs::copy(project("robots/planar-2-link/planar-2-link.urdf"), folder.path().join("planar-2-link.urdf"))
        .unwrap();
    let line = text.lines().find(|line| line.starts_with("physics_hz")).unwrap();
    let write = |text: String| fs::write(folder.path().join("robot.toml"), text).unwrap();
    write(text.clone());
    opspace(folder.path(), &["check", "."]).exits(0);
    write(text.replace(line, "physics_hz = 7777.0"));
    opspace(folder.path(), &["check", "."]).exits(2).says(&["robot.toml:", "not a whole multiple"]);
    let sensor = "\n[force_sensor.tip]\nframe = \"tip\"\n";
    write(text + sensor);
    opspace(folder.path(), &["check", "."]).exits(2).says(&["robot.toml:", "tip"]);
}
