//! Arms and a scene as one model in MuJoCo's format, MJCF.
//!
//! Joints are free of damping, friction, springs and limits: the drivetrains have those. Rotors on rigid gears are
//! armature. The arms come first, so that position and velocity of joint i of the arms are element i of MuJoCo's.

use nalgebra::{Matrix3, Rotation3, SymmetricEigen, UnitQuaternion, Vector3};
use opspace_model::{Inertia, JointKind, Model, Placement};
use opspace_sim::{PlantArm, PlantFrame};
use std::fmt::Write;

/// Inertia that keeps the joints of a load cell at rest, kg or kg m². Larger ones make MuJoCo's solver of contacts inaccurate.
const LOAD_CELL_INERTIA: f64 = 1e6;

/// Smallest mass and moment, kg and kg m²: MuJoCo refuses those below 1e-15.
const SMALLEST_INERTIA: f64 = 1e-14;
/// Largest number of iterations of a decomposition; some ten are enough.
const MAX_ITERATIONS: usize = 1000;

/// Settings of a model.
pub struct ModelSettings {
    /// Time step, s.
    pub step_s: f64,
    /// MuJoCo's integrator: `Euler`, from whose steps the plant takes accelerations, or `RK4`.
    pub integrator: &'static str,
    /// True for contacts between bodies.
    pub has_contacts: bool,
    /// Frame at which a load cell separates the body from the joint that moves it.
    pub load_cell: Option<PlantFrame>,
}

/// Names of the joints of a load cell: forces along x, y and z, then moments about them.
pub const LOAD_CELL: [&str; 6] =
    ["load-cell/fx", "load-cell/fy", "load-cell/fz", "load-cell/mx", "load-cell/my", "load-cell/mz"];

/// Name of a joint and its body in MuJoCo: `arm/JOINT`, with a number for each arm after the first.
pub fn joint_name(arm: usize, joint: &str) -> String {
    format!("{}/{joint}", arm_name(arm))
}

fn arm_name(arm: usize) -> String {
    if arm == 0 { "arm".to_owned() } else { format!("arm{}", arm + 1) }
}

/// Writes arms and the contents of a scene's `<mujoco>` element as one model. The error describes an arm that MuJoCo
/// cannot simulate.
pub fn write(arms: &[PlantArm], scene: Option<&str>, settings: &ModelSettings) -> Result<String, String> {
    let gravity = common_gravity(arms, scene.is_some())?;
    let mut text = String::from("<mujoco>\n<worldbody>\n");
    for (index, arm) in arms.iter().enumerate() {
        if arm.model.has_mimic_constraints() || arm.model.is_floating() {
            let name = arm.model.name();
            return Err(format!(
                "'{name}' has a floating base or mimic constraints, which are simulated by the library's plant alone"
            ));
        }
        let cell = settings.load_cell.filter(|frame| frame.arm == index);
        Arm { index, arm, compensated: arm.model.gravity() != gravity, cell, has_geometry: scene.is_some() }
            .write(&mut text);
    }
    text += "</worldbody>\n";
    text += scene.unwrap_or_default();
    if settings.load_cell.is_some() {
        // MuJoCo's solver of contacts stops early if the mean inertia is large, as that of the load cell is.
        text += "\n<statistic meaninertia=\"1\"/>";
    }
    // Last, because the last value of an attribute is the one that counts.
    let switch = |on: bool| if on { "enable" } else { "disable" };
    text += "\n<compiler inertiafromgeom=\"auto\" balanceinertia=\"false\" boundmass=\"0\" boundinertia=\"0\" \
             settotalmass=\"-1\" fusestatic=\"false\"/>\n";
    let _ = writeln!(
        text,
        "<option timestep=\"{}\" gravity=\"{}\" integrator=\"{}\"><flag autoreset=\"disable\" gravity=\"enable\" \
         contact=\"{}\"{}/></option>\n</mujoco>",
        settings.step_s,
        vector(&gravity),
        settings.integrator,
        switch(settings.has_contacts),
        if scene.is_some() { "" } else { " constraint=\"disable\"" },
    );
    Ok(text)
}

/// Returns the gravity of the world, m/s². That of an arm which compensates its weight is zero, that of a scene is not.
fn common_gravity(arms: &[PlantArm], has_scene: bool) -> Result<Vector3<f64>, String> {
    let mut known: Option<Vector3<f64>> = None;
    for gravity in arms.iter().map(|arm| arm.model.gravity()).filter(|gravity| *gravity != Vector3::zeros()) {
        if known.is_some_and(|known| known != gravity) {
            return Err("the arms have different vectors of gravity".to_owned());
        }
        known = Some(gravity);
    }
    let weightless = if has_scene { Vector3::new(0.0, 0.0, -9.81) } else { Vector3::zeros() };
    Ok(known.unwrap_or(weightless))
}

/// Arm that is written.
struct Arm<'a> {
    index: usize,
    arm: &'a PlantArm,
    /// True if the arm compensates its weight.
    compensated: bool,
    cell: Option<PlantFrame>,
    has_geometry: bool,
}

impl Arm<'_> {
    fn write(&self, text: &mut String) {
        let name = arm_name(self.index);
        let _ = writeln!(text, "<body name=\"{name}\" {}>", pose(&self.arm.model.base()));
        self.write_children(None, text);
        *text += "</body>\n";
    }

    /// Writes capsules and children of a body (of the base, for `None`).
    fn write_children(&self, parent: Option<usize>, text: &mut String) {
        let model = &self.arm.model;
        let capsules = self.arm.capsules.iter().filter(|_| self.has_geometry);
        for (frame, capsule) in capsules.filter(|(frame, _)| model.frame(*frame).body == parent) {
            let capsule = capsule.placed(&model.frame(*frame).placement);
            // Bits of MuJoCo's rule for pairs: geometry of a scene touches the arms, and the arms not one another.
            let bits = "contype=\"1\" conaffinity=\"0\" group=\"3\" mass=\"0\"";
            let radius = capsule.radius_m;
            let _ = if capsule.start_m == capsule.end_m {
                let center = vector(&capsule.start_m);
                writeln!(text, "<geom type=\"sphere\" {bits} size=\"{radius}\" pos=\"{center}\"/>")
            } else {
                let ends = format!("{} {}", vector(&capsule.start_m), vector(&capsule.end_m));
                writeln!(text, "<geom type=\"capsule\" {bits} size=\"{radius}\" fromto=\"{ends}\"/>")
            };
        }
        for body in (0..model.bodies().len()).filter(|&body| model.bodies()[body].parent == parent) {
            self.write_body(model, body, text);
        }
    }

    fn write_body(&self, model: &Model, index: usize, text: &mut String) {
        let body = &model.bodies()[index];
        let name = escaped(&joint_name(self.index, &model.joints()[body.joint].name));
        let compensated = if self.compensated { " gravcomp=\"1\"" } else { "" };
        let _ = writeln!(text, "<body name=\"{name}\" {}{compensated}>", pose(&body.origin));
        let kind = if body.kind == JointKind::Prismatic { "slide" } else { "hinge" };
        write_joint(&name, kind, &Vector3::zeros(), &Vector3::z(), model.rotor_inertia()[body.joint], text);
        let cell = self.cell.filter(|cell| model.frame(cell.frame).body == Some(index));
        if let Some(cell) = cell {
            // A body of its own, because MuJoCo's bodies have at most six joints.
            let nothing = Inertia { mass: 0.0, com: Vector3::zeros(), rotational: Matrix3::zeros() };
            write_inertia(&nothing, text);
            let _ = writeln!(text, "<body name=\"load-cell\"{compensated}>");
            let Placement { rotation, translation } = model.frame(cell.frame).placement;
            for (number, name) in LOAD_CELL.into_iter().enumerate() {
                let kind = if number < 3 { "slide" } else { "hinge" };
                let axis = rotation.column(number % 3).into_owned();
                write_joint(name, kind, &translation, &axis, LOAD_CELL_INERTIA, text);
            }
        }
        write_inertia(&body.inertia, text);
        self.write_children(Some(index), text);
        *text += if cell.is_some() { "</body></body>\n" } else { "</body>\n" };
    }
}

/// Writes the inertia of a body.
fn write_inertia(inertia: &Inertia, text: &mut String) {
    let (moments, rotation) = principal_axes(&inertia.rotational);
    let _ = writeln!(
        text,
        "<inertial mass=\"{}\" diaginertia=\"{}\" {}/>",
        inertia.mass.max(SMALLEST_INERTIA),
        vector(&moments),
        pose(&Placement { rotation, translation: inertia.com })
    );
}

/// Writes a joint. Every attribute is stated, because a scene can have defaults of its own.
fn write_joint(
    name: &str,
    kind: &str,
    point: &Vector3<f64>,
    axis: &Vector3<f64>,
    inertia: f64,
    text: &mut String,
) {
    let _ = writeln!(
        text,
        "<joint name=\"{name}\" type=\"{kind}\" pos=\"{}\" axis=\"{}\" armature=\"{inertia}\" damping=\"0\" \
         frictionloss=\"0\" stiffness=\"0\" springref=\"0\" springdamper=\"0 0\" ref=\"0\" limited=\"false\" \
         actuatorfrclimited=\"false\"/>",
        vector(point),
        vector(axis)
    );
}

fn vector(v: &Vector3<f64>) -> String {
    format!("{} {} {}", v.x, v.y, v.z)
}

fn pose(placement: &Placement) -> String {
    let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(placement.rotation));
    format!("pos=\"{}\" quat=\"{} {} {} {}\"", vector(&placement.translation), q.w, q.i, q.j, q.k)
}

/// Returns the principal moments of a rotational inertia, and the rotation whose columns are their axes: MuJoCo computes
/// them to eight digits only, up to version 3.8 at least.
fn principal_axes(rotational: &Matrix3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
    let decomposed = SymmetricEigen::try_new(*rotational, f64::EPSILON, MAX_ITERATIONS);
    let (moments, mut axes) = match decomposed {
        Some(decomposed) => (decomposed.eigenvalues, decomposed.eigenvectors),
        None => (rotational.diagonal(), Matrix3::identity()),
    };
    if axes.determinant() < 0.0 {
        axes.column_mut(0).neg_mut();
    }
    (moments.map(|moment| moment.max(SMALLEST_INERTIA)), axes)
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

/// Returns the files that a scene includes, as it names them; none if it is not XML.
pub fn included(scene: &str) -> Vec<String> {
    let Ok(document) = roxmltree::Document::parse(scene) else { return Vec::new() };
    let elements = document.descendants().filter(|node| node.has_tag_name("include"));
    elements.filter_map(|node| node.attribute("file")).map(str::to_owned).collect()
}

/// Returns the text between the tags of a scene's `<mujoco>` element; `None` if it has no such element.
pub fn contents(scene: &str) -> Option<&str> {
    let document = roxmltree::Document::parse(scene).ok()?;
    let root = document.root_element();
    if !root.has_tag_name("mujoco") {
        return None;
    }
    match (root.first_child(), root.last_child()) {
        (Some(first), Some(last)) => scene.get(first.range().start..last.range().end),
        _ => Some(""),
    }
}
