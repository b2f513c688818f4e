//! Dependencies of the workspace: DESIGN.md gives a reason for each.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// Head of the table in DESIGN.md.
const HEAD: &str = "| crate | used by | why | what it would take to do without |";

/// Compared: the dependencies in Cargo.toml except the crates of the workspace, and the rows of the table in
/// DESIGN.md.
#[test]
fn every_dependency_has_a_row_in_the_table_of_reasons() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let read = |name: &str| fs::read_to_string(root.join(name)).expect("a file of the project");
    let manifest: toml::Table = toml::from_str(&read("Cargo.toml")).expect("a manifest");
    let dependencies = manifest["workspace"]["dependencies"].as_table().expect("a table");
    let foreign = |value: &toml::Value| value.get("path").is_none();
    let used: BTreeSet<String> =
        dependencies.iter().filter(|(_, value)| foreign(value)).map(|(name, _)| name.clone()).collect();
    let design = read("DESIGN.md");
    let rows = rows(&design);
    assert!(used.len() > 10 && rows.len() > 10, "{} dependencies, {} rows", used.len(), rows.len());
    let listed: BTreeSet<String> = rows.iter().map(|cells| cells[0].to_owned()).collect();
    assert_eq!(listed.len(), rows.len(), "a crate has two rows");
    let missing: Vec<_> = used.difference(&listed).collect();
    let stale: Vec<_> = listed.difference(&used).collect();
    assert!(missing.is_empty(), "without a row in DESIGN.md: {missing:?}");
    assert!(stale.is_empty(), "in DESIGN.md, but not in Cargo.toml: {stale:?}");
    for cells in rows {
        assert!(cells.len() == 4 && cells.iter().all(|cell| !cell.is_empty()), "an empty cell: {cells:?}");
    }
}

/// Compared: the crates that each crate depends on, and the order of the crates in the table of ARCHITECTURE.md. What only
/// tests depend on may be below.
#[test]
fn crates_depend_on_crates_above_them() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let read = |name: &str| fs::read_to_string(root.join(name)).expect("a file of the project");
    let architecture = read("ARCHITECTURE.md");
    let row = |line: &str| Some(line.strip_prefix("| `crates/")?.split_once('`')?.0.to_owned());
    let order: Vec<String> = architecture.lines().filter_map(row).collect();
    let mut depends = 0;
    for entry in fs::read_dir(root.join("crates")).expect("the folder of the crates") {
        let name = entry.expect("a folder").file_name().to_string_lossy().into_owned();
        let manifest: toml::Table =
            toml::from_str(&read(&format!("crates/{name}/Cargo.toml"))).expect("a manifest");
        let place =
            order.iter().position(|other| *other == name).unwrap_or_else(|| panic!("no row of {name}"));
        let dependencies = manifest.get("dependencies").and_then(toml::Value::as_table).into_iter().flatten();
        for (dependency, _) in dependencies.filter(|(dependency, _)| dependency.starts_with("opspace")) {
            depends += 1;
            assert!(
                order[..place].contains(dependency),
                "{name} depends on {dependency}, which is not above it"
            );
        }
    }
    assert!(depends > 30, "only {depends} dependencies between crates");
}

/// Compared: the optimisation of dependencies in tests/own-driver and in this workspace. If they differed, .ci/run would
/// compile the dependencies twice.
#[test]
fn own_driver_compiles_the_dependencies_as_this_workspace() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let read = |name: &str| {
        let text = fs::read_to_string(root.join(name)).expect("a file of the project");
        let manifest: toml::Table = toml::from_str(&text).expect("a manifest");
        let mut profile = manifest["profile"]["dev"].as_table().expect("a table").clone();
        let packages = profile["package"].as_table_mut().expect("a table");
        packages.retain(|name, _| !name.starts_with("opspace"));
        profile
    };
    let (mut here, there) = (read("Cargo.toml"), read("tests/own-driver/Cargo.toml"));
    // Only tests use it: it would be named in vain there.
    here["package"].as_table_mut().expect("a table").remove("chacha20");
    assert!(here["package"].as_table().expect("a table").len() > 5, "{here:?}");
    assert_eq!(here, there);
}

/// Cells of the table rows.
fn rows(design: &str) -> Vec<Vec<&str>> {
    let table = design.lines().skip_while(|line| *line != HEAD).skip(2);
    table
        .take_while(|line| line.starts_with('|'))
        .map(|line| line.trim_matches('|').split('|').map(str::trim).collect())
        .collect()
}
