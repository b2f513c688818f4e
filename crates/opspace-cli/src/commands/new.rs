//! `opspace new`: creates a folder for a new robot.

use crate::cli::{NewArgs, SchemaKind};
use crate::commands::schema::text as schema_text;
use crate::console::{Console, Exit, Failure, Outcome, print};
use crate::output::write;
use crate::xacro::expanded;
use opspace_backend::CommandKind;
use opspace_experiment::files::mount::MountFile;
use opspace_experiment::{Extensions, Source};
use opspace_model::files::open_file;
use opspace_setup::arm_template::ArmTemplate;
use opspace_setup::new_robot::{DriveValues, KnownMasses, NewFiles, Part, new_files};
use std::fs;
use std::io;
use std::path::Path;

pub fn new(args: &NewArgs, extensions: &Extensions, console: Console) -> Outcome {
    let template = match &args.like {
        Some(None) => return list_templates(),
        Some(Some(name)) => Some(ArmTemplate::named(name)?),
        None => args.like_anyway.as_deref().map(ArmTemplate::named).transpose()?,
    };
    let (Some(dir), Some(urdf)) = (&args.dir, &args.urdf) else {
        let text = "a new robot needs a folder and a URDF: opspace new DIR --urdf FILE --like ARM".to_owned();
        return Err(Failure::Other(text, Exit::Bad));
    };
    create(args, extensions, (dir, urdf), template.as_ref(), console)
}

/// Prints the names of the templates.
fn list_templates() -> Outcome {
    let mut text = String::new();
    for template in ArmTemplate::all()? {
        text +=
            &format!("{:<10} {}, joints: {}\n", template.name, template.about, template.joints.join(", "));
    }
    print(&text)?;
    Ok(Exit::Done)
}

fn create(
    args: &NewArgs,
    extensions: &Extensions,
    (dir, file): (&Path, &Path),
    template: Option<&ArmTemplate>,
    console: Console,
) -> Outcome {
    let source = match file.extension().is_some_and(|extension| extension == "xacro") {
        true => Source::new(file.display().to_string(), expanded(file)?),
        false => Source::read(file)?,
    };
    let robot = dir.join("robot.toml");
    let urdf = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let urdf = urdf.strip_suffix(".xacro").map_or(urdf.clone(), |name| match name.ends_with(".urdf") {
        true => name.to_owned(),
        false => format!("{name}.urdf"),
    });
    let part = Part { from: args.from.as_deref(), to: args.to.as_deref(), mount: mount(&args.mount)? };
    let values = match (template, args.assume) {
        (Some(template), _) if args.like_anyway.is_some() => DriveValues::InterfaceOf(template),
        (Some(template), _) => DriveValues::Template(template),
        (None, true) => DriveValues::Assumed(KnownMasses { arm_kg: args.mass, payload_kg: args.payload }),
        (None, false) => DriveValues::Missing,
    };
    let NewFiles { robot_toml, task_toml, motion, warnings, command, unmatched_joints, notes, .. } =
        new_files(&source, &urdf, part, values)?;
    warnings.iter().for_each(|w| console.note(&format!("{}: {w} [{}]", source.name(), w.kind().code())));
    if !unmatched_joints.is_empty() {
        console.note(&format!(
            "locked, since the template has no values of these joints: {}",
            unmatched_joints.join(", ")
        ));
    }
    if robot.exists() {
        return Err(Failure::Other(existing_text(dir, file), Exit::Bad));
    }
    fs::create_dir_all(dir).map_err(|e| Failure::io("cannot be created", dir, &e))?;
    let copy = dir.join(&urdf);
    match open_file(&copy).and_then(io::read_to_string) {
        // The copy already exists, or is the same file.
        Ok(text) if text == source.text() => {}
        Ok(_) => {
            let text = format!("{}: already exists and differs from {}", copy.display(), source.name());
            let other = free_folder(dir);
            return Err(Failure::Other(
                format!("{text}; choose another folder, for example {other}"),
                Exit::Bad,
            ));
        }
        Err(_) => write(&copy, source.text())?,
    }
    for (name, schema) in [("robot.schema.json", SchemaKind::Robot), ("task.schema.json", SchemaKind::Task)] {
        write(&dir.join(name), &schema_text(schema, extensions))?;
    }
    write(&robot, &robot_toml)?;
    let task = dir.join("first-task.toml");
    if !task.exists() {
        write(&task, &task_toml)?;
    }
    let (task, dir) = (task.display(), dir.display());
    let (fill, first) = match command {
        Some(_) => (
            format!("Values marked [A] in {} are assumed: results rest on them.\n", robot.display()),
            String::new(),
        ),
        None => (
            String::new(),
            format!(
                "  opspace check {dir}   # lists the missing values: write them into {}\n",
                robot.display()
            ),
        ),
    };
    let notes: String = notes.iter().map(|note| format!("NOTE {note}\n")).collect();
    let command = command.unwrap_or(CommandKind::Position).name();
    let name = robot.parent().and_then(|dir| dir.file_name()).unwrap_or_default().to_string_lossy();
    print(&format!(
        "{}\n{}\n{task}\n{motion}\n{notes}{fill}Next:\n{first}  opspace check {task}\n  opspace run {task}\n  \
         opspace report runs/first-task-{name}-{command}\n  opspace model {dir}\n",
        robot.display(),
        copy.display(),
    ))?;
    Ok(Exit::Done)
}

/// Mounting of the base at the pose of --mount, if it is given.
fn mount(pose: &[f64]) -> Result<Option<MountFile>, Failure> {
    let mount = match *pose {
        [] => return Ok(None),
        [x, y, z] => MountFile::new([x, y, z], [0.0; 3]),
        [x, y, z, roll, pitch, yaw] => MountFile::new([x, y, z], [roll, pitch, yaw]),
        _ => {
            let text =
                format!("--mount has {} values: give x,y,z, or x,y,z,roll,pitch,yaw (m, rad)", pose.len());
            return Err(Failure::Other(text, Exit::Bad));
        }
    };
    match mount.mistake() {
        Some((_, message, help)) => Err(Failure::Other(format!("--mount: {message}; {help}"), Exit::Bad)),
        None => Ok(Some(mount)),
    }
}

/// Says what to do if a folder already has a robot.toml, for example from an earlier `new` with other options.
fn existing_text(dir: &Path, urdf: &Path) -> String {
    let (robot, task) = (dir.join("robot.toml"), dir.join("first-task.toml"));
    let files = if task.exists() {
        format!("{} and {}", robot.display(), task.display())
    } else {
        robot.display().to_string()
    };
    format!(
        "{}: already exists, and `new` replaces no file; choose another folder: `opspace new {} --urdf {}` with the same \
         options. Or delete {files}, with all values that you wrote into them, and repeat the command",
        robot.display(),
        free_folder(dir),
        urdf.display()
    )
}

/// Name of a folder beside `dir` that does not exist.
fn free_folder(dir: &Path) -> String {
    let name = dir.file_name().unwrap_or("robot".as_ref()).to_string_lossy();
    let mut numbered = (2..).map(|number| dir.with_file_name(format!("{name}-{number}")));
    numbered.find(|other| !other.exists()).unwrap_or_default().display().to_string()
}
