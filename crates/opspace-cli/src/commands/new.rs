//! `opspace new`: creates a folder for a new robot.

use crate::cli::{NewArgs, SchemaKind};
use crate::commands::schema::text as schema_text;
use crate::console::{Console, Exit, Failure, Outcome, print};
use crate::output::write;
use opspace_experiment::Source;
use opspace_experiment::files::robot::load_urdf;
use opspace_experiment::files::template::{robot_toml, task_toml};
use opspace_model::UrdfOptions;
use std::fs;

pub fn new(args: &NewArgs, console: Console) -> Outcome {
    let source = Source::read(&args.urdf)?;
    let loaded = load_urdf(&source, UrdfOptions::default())?;
    loaded.warnings.iter().for_each(|w| console.note(&format!("{}: {w}", source.name())));
    let robot = args.dir.join("robot.toml");
    if robot.exists() {
        let text = format!("{}: already exists; choose another folder", robot.display());
        return Err(Failure::Other(text, Exit::Bad));
    }
    fs::create_dir_all(&args.dir).map_err(|e| Failure::io("cannot be created", &args.dir, &e))?;
    let urdf = args.urdf.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let copy = args.dir.join(&urdf);
    match fs::read_to_string(&copy) {
        // The copy already exists, or is the same file.
        Ok(text) if text == source.text() => {}
        Ok(_) => {
            let text = format!("{}: already exists and differs from {}", copy.display(), source.name());
            return Err(Failure::Other(text + "; choose another folder", Exit::Bad));
        }
        Err(_) => write(&copy, source.text())?,
    }
    for (name, schema) in [("robot.schema.json", SchemaKind::Robot), ("task.schema.json", SchemaKind::Task)] {
        write(&args.dir.join(name), &schema_text(schema))?;
    }
    write(&robot, &robot_toml(&urdf, &loaded.model))?;
    let task = args.dir.join("hold.toml");
    if !task.exists() {
        write(&task, &task_toml(&loaded.model))?;
    }
    print(&format!(
        "{robot}\n{copy}\n{task}\n\
         Next: write the values into {robot}; `opspace check {dir}` names the next missing value.\n\
         Then: opspace run {task}\n",
        robot = robot.display(),
        copy = copy.display(),
        task = task.display(),
        dir = args.dir.display(),
    ))?;
    Ok(Exit::Done)
}
