//! Files of a checkout that users run or check, wherever they are in its folders.

use std::fs;
use std::path::{Path, PathBuf};

/// Folders that contain the files, here or in a base to compare with; one that a checkout lacks is left out.
const FOLDERS: [&str; 3] = ["tasks", "experiments", "robots"];

/// Kind of a file, as far as it matters here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Suite.
    Suite,
    /// Task, or experiment with several robots: a file that can be run alone.
    Run,
    /// Robot.
    Robot,
}

/// File of a checkout.
#[derive(Clone, Debug)]
pub struct Shipped {
    /// Path from the checkout's folder.
    pub path: PathBuf,
    /// Name by which the files of two checkouts are paired.
    pub name: String,
    /// Kind.
    pub kind: Kind,
}

/// Lists the files of a checkout, by name.
///
/// # Errors
/// A folder or file that cannot be read, and two files of one name.
pub fn shipped(checkout: &Path) -> Result<Vec<Shipped>, String> {
    let mut files = Vec::new();
    for folder in FOLDERS.map(|folder| checkout.join(folder)).iter().filter(|folder| folder.exists()) {
        collect(checkout, folder, &mut files).map_err(|e| format!("{}: {e}", folder.display()))?;
    }
    files.sort_by(|a, b| a.name.cmp(&b.name));
    match files.windows(2).find(|pair| pair[0].name == pair[1].name) {
        Some([a, b]) => Err(format!("{} and {} have one name", a.path.display(), b.path.display())),
        _ => Ok(files),
    }
}

fn collect(checkout: &Path, folder: &Path, files: &mut Vec<Shipped>) -> Result<(), String> {
    for entry in fs::read_dir(folder).map_err(|e| e.to_string())? {
        let path = entry.map_err(|e| e.to_string())?.path();
        if path.is_dir() {
            collect(checkout, &path, files)?;
        } else if path.extension().is_some_and(|end| end == "toml") {
            let text = fs::read_to_string(&path).map_err(|e| e.to_string())?;
            let file: toml::Table = toml::from_str(&text).map_err(|e| e.to_string())?;
            let path = path.strip_prefix(checkout).map_err(|e| e.to_string())?.to_owned();
            files.push(Shipped { name: without_folders(&path.to_string_lossy()), kind: kind(&file), path });
        }
    }
    Ok(())
}

fn kind(file: &toml::Table) -> Kind {
    if file.contains_key("run") {
        Kind::Suite
    } else if file.contains_key("urdf") {
        Kind::Robot
    } else {
        Kind::Run
    }
}

/// Name of a file without its folders, because files may move; every robot's file has the same name, to which its folder
/// belongs.
fn without_folders(path: &str) -> String {
    let mut parts = path.rsplit('/');
    let (name, folder) = (parts.next().unwrap_or_default(), parts.next());
    match folder {
        Some(folder) if name == "robot.toml" => format!("{folder}/{name}"),
        _ => name.to_owned(),
    }
}

/// Replaces every path of a file in a text by the name of the file without folders.
#[must_use]
pub fn without_paths(text: &str) -> String {
    let is_of_path = |c: char| c.is_alphanumeric() || "_-./".contains(c);
    let mut result = String::new();
    let mut rest = text;
    while let Some(begin) = rest.find(is_of_path) {
        let end = rest[begin..].find(|c| !is_of_path(c)).map_or(rest.len(), |length| begin + length);
        // A path at the end of a sentence is followed by its full stop.
        let word = rest[begin..end].trim_end_matches('.');
        result += &rest[..begin];
        result += &if is_file(word) { without_folders(word) } else { word.to_owned() };
        result += &rest[begin + word.len()..end];
        rest = &rest[end..];
    }
    result + rest
}

fn is_file(word: &str) -> bool {
    let endings = [".toml", ".urdf", ".csv", ".mcap", ".html", ".json", ".jsonl"];
    endings.iter().any(|ending| word.ends_with(ending))
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test")]
mod tests {
    use super::{Kind, shipped, without_paths};
    use std::fs;
    use std::path::Path;

    /// Compared: a text with paths, and the text that stays the same when files move.
    #[test]
    fn paths_are_shortened_and_units_are_not() {
        for (text, expected) in [
            ("tasks/suites/../a.toml:3:1: 2 N/m", "a.toml:3:1: 2 N/m"),
            ("\"../b_c-d.toml\" and /tmp/x.y/robots/e/robot.toml.", "\"b_c-d.toml\" and e/robot.toml."),
            ("`robot.toml` at 1/2 rad/s, tasks/", "`robot.toml` at 1/2 rad/s, tasks/"),
            ("", ""),
        ] {
            assert_eq!(without_paths(text), expected);
        }
    }

    /// Compared: the names of the same files in two arrangements of folders.
    #[test]
    fn files_are_paired_wherever_they_are() {
        let names = |files: &[(&str, &str)]| {
            let checkout = tempfile::tempdir().unwrap();
            for (path, text) in files {
                let path = checkout.path().join(path);
                fs::create_dir_all(path.parent().unwrap()).unwrap();
                fs::write(path, text).unwrap();
            }
            let files = shipped(checkout.path())?;
            Ok::<_, String>(files.into_iter().map(|file| (file.name, file.kind)).collect::<Vec<_>>())
        };
        let before = names(&[
            ("experiments/b.toml", "[robots.a]"),
            ("tasks/a.toml", "robot = \"r\""),
            ("robots/r/robot.toml", "urdf = \"r.urdf\""),
            ("tasks/s.toml", "[[run]]"),
            ("tasks/a.csv", "1"),
        ]);
        let after = names(&[
            ("tasks/experiments/b.toml", "[robots.a]"),
            ("tasks/a.toml", "robot = \"r\""),
            ("robots/arms/r/robot.toml", "urdf = \"r.urdf\""),
            ("tasks/suites/s.toml", "[[run]]"),
        ]);
        assert_eq!(before, after);
        let [a, b] = ["a", "b"].map(|name| (format!("{name}.toml"), Kind::Run));
        let expected =
            vec![a, b, ("r/robot.toml".to_owned(), Kind::Robot), ("s.toml".to_owned(), Kind::Suite)];
        assert_eq!(before, Ok(expected));
        assert!(names(&[("tasks/a.toml", ""), ("tasks/more/a.toml", "")]).is_err());
    }

    /// Compared: the kinds of files of the project, and the folders in which they are at present.
    #[test]
    fn files_of_the_project_are_known() {
        let checkout = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let files = shipped(&checkout).unwrap();
        for kind in [Kind::Suite, Kind::Run, Kind::Robot] {
            assert!(files.iter().filter(|file| file.kind == kind).count() > 3, "{kind:?}");
        }
        for file in files {
            assert_eq!(file.kind == Kind::Robot, file.path.starts_with("robots"), "{}", file.name);
        }
    }
}
