//! URDFs of arms as people publish them: chains, SCARA, gantries, two arms, mimic joints, and files that lack or round what a
//! simulation needs.

use opspace_testing::random::Random;
use std::fmt::Write as _;

/// Kinds of files.
const KINDS: [&str; 10] = [
    "chain",
    "scara",
    "gantry",
    "two-arms",
    "mimic",
    "no-inertials",
    "rounded-inertials",
    "placeholder-efforts",
    "light-last-link",
    "odd-text",
];

/// Kind of the file of this number.
pub fn kind(number: usize) -> &'static str {
    KINDS[number % KINDS.len()]
}

/// Properties of the numbers in a file.
#[derive(Clone, Copy)]
struct Style {
    has_inertials: bool,
    /// Decimals of inertias.
    decimals: usize,
    /// Effort in place of a plausible one.
    effort: Option<f64>,
    /// Mass of the last link over a usual one.
    last_link: f64,
    has_shapes: bool,
}

/// URDF of an arm of the kind of this number.
pub fn urdf(number: usize, seed: u64) -> String {
    let random = &mut Random(seed.wrapping_mul(1000).wrapping_add(number as u64));
    let kind = kind(number);
    let size = if random.is(0.3) { random.between(0.25, 0.5) } else { random.between(0.6, 1.6) };
    let style = Style {
        has_inertials: kind != "no-inertials",
        decimals: if kind == "rounded-inertials" { random.below(4) } else { 9 },
        effort: (kind == "placeholder-efforts").then(|| [0.0, 1000.0, 1e9, 100.0, 1.0][random.below(5)]),
        last_link: if kind == "light-last-link" { random.between(0.001, 0.05) } else { 1.0 },
        has_shapes: random.is(0.4),
    };
    let mut file = File { text: String::new(), random, style, size };
    let _ =
        write!(file.text, "<?xml version=\"1.0\"?>\n<robot name=\"{kind}\">\n<link name=\"base_link\"/>\n");
    match kind {
        "scara" => file.scara(),
        "gantry" => file.gantry(),
        "two-arms" => {
            for side in ["left", "right"] {
                let y = if side == "left" { 0.25 } else { -0.25 };
                let _ = write!(
                    file.text,
                    "<link name=\"{side}_mount\"/>\n{}",
                    fixed(
                        &format!("{side}_mount_joint"),
                        "base_link",
                        &format!("{side}_mount"),
                        [0.0, y * size, 0.4]
                    )
                );
                file.chain(&format!("{side}_"), &format!("{side}_mount"), 6);
            }
        }
        "mimic" => {
            file.chain("", "base_link", 6);
            file.gripper();
        }
        _ => {
            let joints = 4 + file.random.below(4);
            file.chain("", "base_link", joints);
        }
    }
    if kind == "odd-text" {
        file.text = file.text.replace(
            "<link name=\"base_link\"/>",
            "<link name=\"base_link\"/>\n<gazebo><controller:gazebo_ros name=\"x\"/></gazebo>",
        );
        file.text = file.text.replacen("velocity=\"", "velocity=\"-", 2);
    }
    file.text + "</robot>\n"
}

fn fixed(name: &str, parent: &str, child: &str, [x, y, z]: [f64; 3]) -> String {
    format!(
        "<joint name=\"{name}\" type=\"fixed\"><parent link=\"{parent}\"/><child link=\"{child}\"/><origin xyz=\"{x:.4} {y:.4} {z:.4}\"/></joint>\n"
    )
}

struct File<'a> {
    text: String,
    random: &'a mut Random,
    style: Style,
    /// Reach, m.
    size: f64,
}

impl File<'_> {
    fn link(&mut self, name: &str, along: [f64; 3], mass: f64) {
        let length = along.iter().map(|x| x * x).sum::<f64>().sqrt().max(0.04);
        let _ = write!(self.text, "<link name=\"{name}\">");
        if self.style.has_inertials {
            let radius = 0.2 * length + 0.01;
            let across = mass * (3.0 * radius * radius + length * length) / 12.0;
            let inertia = format!("{across:.*}", self.style.decimals);
            let [x, y, z] = along.map(|x| 0.5 * x);
            let _ = write!(
                self.text,
                "<inertial><origin xyz=\"{x:.4} {y:.4} {z:.4}\"/><mass value=\"{mass:.4}\"/><inertia ixx=\"{inertia}\" iyy=\"{inertia}\" \
                 izz=\"{inertia}\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial>"
            );
        }
        if self.style.has_shapes {
            let [x, y, z] = along.map(|x| 0.5 * x);
            let _ = write!(
                self.text,
                "<collision><origin xyz=\"{x:.4} {y:.4} {z:.4}\"/><geometry><box size=\"{:.4} {:.4} {:.4}\"/></geometry></collision>",
                along[0].abs() + 0.05,
                along[1].abs() + 0.05,
                along[2].abs() + 0.05
            );
        }
        self.text += "</link>\n";
    }

    fn joint(
        &mut self,
        kind: &str,
        name: &str,
        [parent, child]: [&str; 2],
        at: [f64; 3],
        axis: &str,
        need: f64,
    ) {
        let [x, y, z] = at;
        let limits = match kind {
            "continuous" => String::new(),
            "prismatic" => format!("lower=\"0\" upper=\"{:.3}\" ", self.random.between(0.2, 0.5) * self.size),
            _ => format!(
                "lower=\"-{:.3}\" upper=\"{:.3}\" ",
                self.random.between(1.6, 3.0),
                self.random.between(1.6, 3.0)
            ),
        };
        let effort = self.style.effort.unwrap_or_else(|| need * self.random.between(1.5, 6.0));
        let velocity = self.random.between(1.0, 4.0);
        let _ = writeln!(
            self.text,
            "<joint name=\"{name}\" type=\"{kind}\"><parent link=\"{parent}\"/><child link=\"{child}\"/><origin xyz=\"{x:.4} {y:.4} {z:.4}\"/>\
             <axis xyz=\"{axis}\"/><limit {limits}effort=\"{effort:.3}\" velocity=\"{velocity:.3}\"/></joint>"
        );
    }

    /// Mass of a link at a share of the reach from the base, kg.
    fn mass(&mut self, share: f64) -> f64 {
        self.size.powi(3) * 12.0 * (1.0 - 0.8 * share) * self.random.between(0.5, 1.5)
    }

    /// Arm with axes as industrial arms have them: one upright, two across, then wrist axes in turns.
    fn chain(&mut self, prefix: &str, from: &str, joints: usize) {
        const AXES: [&str; 7] = ["0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0", "0 1 0"];
        let share = [0.15, 0.35, 0.3, 0.05, 0.08, 0.05, 0.04];
        let (mut parent, mut end) = (from.to_owned(), [0.0, 0.0, 0.2 * self.size]);
        for i in 0..joints {
            let child = format!("{prefix}link_{}", i + 1);
            let lever = self.size * (1.0 - share[..i].iter().sum::<f64>()).max(0.1);
            let need = 60.0 * self.size.powi(3) * lever.max(0.05) + 0.5;
            let kind = if self.random.is(0.1) { "continuous" } else { "revolute" };
            self.joint(kind, &format!("{prefix}joint_{}", i + 1), [&parent, &child], end, AXES[i], need);
            let length = share[i] * self.size * self.random.between(0.7, 1.3);
            let along = if i < 2 { [0.0, 0.0, length] } else { [length, 0.0, 0.0] };
            let last = if i + 1 == joints { self.style.last_link } else { 1.0 };
            let mass = last * self.mass(share[..i].iter().sum());
            self.link(&child, along, mass);
            (parent, end) = (child, along);
        }
        let tool = format!("{prefix}tool0");
        let _ = write!(
            self.text,
            "<link name=\"{tool}\"/>\n{}",
            fixed(&format!("{prefix}flange"), &parent, &tool, end)
        );
    }

    /// Four joints: two upright axes, a stroke, and a wrist.
    fn scara(&mut self) {
        let (a, b) = (0.5 * self.size, 0.4 * self.size);
        let need = 20.0 * self.size.powi(3) + 2.0;
        self.joint("revolute", "axis_1", ["base_link", "arm_1"], [0.0, 0.0, 0.3], "0 0 1", need);
        let mass = self.mass(0.2);
        self.link("arm_1", [a, 0.0, 0.0], mass);
        self.joint("revolute", "axis_2", ["arm_1", "arm_2"], [a, 0.0, 0.0], "0 0 1", 0.5 * need);
        let mass = self.mass(0.6);
        self.link("arm_2", [b, 0.0, 0.0], mass);
        self.joint("prismatic", "axis_3", ["arm_2", "quill"], [b, 0.0, -0.1], "0 0 -1", 60.0);
        self.link("quill", [0.0, 0.0, -0.1], 0.6);
        self.joint("revolute", "axis_4", ["quill", "flange"], [0.0, 0.0, -0.1], "0 0 1", 1.0);
        self.link("flange", [0.0, 0.0, -0.03], 0.2);
    }

    /// Three slides and a wrist of three joints.
    fn gantry(&mut self) {
        let mut parent = "base_link".to_owned();
        for (i, axis) in ["1 0 0", "0 1 0", "0 0 1"].into_iter().enumerate() {
            let child = format!("slide_{i}");
            let mass = self.random.between(3.0, 12.0) / (1.0 + i as f64);
            self.joint(
                "prismatic",
                &format!("slide_{i}_joint"),
                [&parent, &child],
                [0.0, 0.0, 0.3],
                axis,
                250.0,
            );
            self.link(&child, [0.1, 0.0, 0.1], mass);
            parent = child;
        }
        for (i, axis) in ["0 0 1", "0 1 0", "1 0 0"].into_iter().enumerate() {
            let child = format!("wrist_{i}");
            self.joint(
                "revolute",
                &format!("wrist_{i}_joint"),
                [&parent, &child],
                [0.05, 0.0, 0.0],
                axis,
                6.0,
            );
            self.link(&child, [0.06, 0.0, 0.0], 0.6);
            parent = child;
        }
    }

    /// Gripper of two fingers, one of which mimics the other.
    fn gripper(&mut self) {
        for (side, y) in [("left", 0.02), ("right", -0.02)] {
            let child = format!("finger_{side}");
            let mimic = if side == "right" { "<mimic joint=\"finger_left_joint\"/>" } else { "" };
            let axis = if side == "left" { "0 1 0" } else { "0 -1 0" };
            let _ = writeln!(
                self.text,
                "<joint name=\"finger_{side}_joint\" type=\"prismatic\"><parent link=\"tool0\"/><child link=\"{child}\"/>\
                 <origin xyz=\"0.05 {y} 0\"/><axis xyz=\"{axis}\"/><limit lower=\"0\" upper=\"0.04\" effort=\"20\" velocity=\"0.2\"/>{mimic}</joint>"
            );
            self.link(&child, [0.05, 0.0, 0.0], 0.05);
        }
    }
}
