//! `--open`: the report is opened by the opener of the platform, here a fake one.
#![cfg(all(unix, not(target_os = "macos")))]
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::cli_common::{circle_folder, command, read};
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Output;

const SUITE: &str = "title = \"t\"\n[[run]]\ntasks = [\"circle.toml\"]\n";

/// Runs the program with a search path on which only the fake opener is.
fn with_opener(folder: &Path, arguments: &[&str]) -> Output {
    command(folder, arguments).env("PATH", folder.join("bin")).output().unwrap()
}

/// Writes a fake opener that writes its argument to `opened`, and exits with this code.
fn fake(folder: &Path, code: i32) {
    let bin = folder.join("bin");
    fs::create_dir_all(&bin).unwrap();
    let script = bin.join("xdg-open");
    let opened = folder.join("opened").display().to_string();
    fs::write(&script, format!("#!/bin/sh\necho \"$1\" > '{opened}'\nexit {code}\n")).unwrap();
    fs::set_permissions(&script, fs::Permissions::from_mode(0o755)).unwrap();
}

#[test]
fn report_is_opened_after_run_bench_and_report() {
    let folder = circle_folder(SUITE);
    fake(folder.path(), 0);
    for (arguments, page) in [
        (&["run", "circle.toml", "--out", "out", "--open"][..], "out/report.html"),
        (&["report", "out", "-o", "again.html", "--open"], "again.html"),
        (&["bench", "suite.toml", "--out", "suite", "--open"], "suite/report.html"),
    ] {
        let ran = with_opener(folder.path(), arguments);
        let said = String::from_utf8(ran.stderr).unwrap();
        assert!(ran.status.success() && said.contains("opened "), "{said}");
        let opened = read(folder.path().join("opened"));
        assert_eq!(Path::new(opened.trim()), folder.path().join(page).canonicalize().unwrap());
        fs::remove_file(folder.path().join("opened")).unwrap();
    }
    let closed = with_opener(folder.path(), &["run", "circle.toml", "--out", "closed"]);
    assert!(closed.status.success() && !folder.path().join("opened").exists());
}

/// Without a browser the run is none the worse, and the page is named.
#[test]
fn missing_browser_is_said() {
    let folder = circle_folder(SUITE);
    for (code, words) in [(None, "'xdg-open' was not found"), (Some(3), "'xdg-open' failed")] {
        if let Some(code) = code {
            fake(folder.path(), code);
        }
        let out = format!("out-{}", code.unwrap_or(0));
        let ran = with_opener(folder.path(), &["run", "circle.toml", "--out", &out, "--open"]);
        let said = String::from_utf8(ran.stderr).unwrap();
        assert!(ran.status.success(), "{said}");
        let page = folder.path().join(&out).canonicalize().unwrap().join("report.html");
        let sentence = format!("no browser was opened ({words}): open {} in one", page.display());
        assert!(said.contains(&sentence), "{said}");
    }
}
