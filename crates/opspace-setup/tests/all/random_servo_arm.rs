//! Random light arms with servos without a velocity loop, as files, with the truth about them.

use opspace_experiment::{RobotDefinition, Source};
use std::fmt::Write as _;

/// Pseudo-random numbers.
pub struct Random(u64);

impl Random {
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        // SplitMix64.
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^= z >> 31;
        low + (high - low) * (z >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// A factor from 1/`most` to `most`, uniform in its logarithm.
    fn times(&mut self, most: f64) -> f64 {
        most.powf(self.between(-1.0, 1.0))
    }

    fn one_of<T: Copy>(&mut self, values: &[T]) -> T {
        values[(self.between(0.0, values.len() as f64) as usize).min(values.len() - 1)]
    }
}

/// Gravity, m/s².
const G: f64 = 9.81;

/// True parameters of a joint.
#[derive(Clone, Copy, Debug)]
pub struct TrueJoint {
    pub stiffness: f64,
    pub coulomb: f64,
    pub viscous: f64,
    /// Stiffness in the file over the true one.
    pub declared: f64,
}

/// A random arm: a vertical axis, then two or three horizontal ones.
pub struct RandomArm {
    pub joints: Vec<TrueJoint>,
    urdf: String,
    robot: String,
    weight_kg: f64,
}

/// Largest backlash from end to end, rad.
pub const BACKLASH_RAD: f64 = 1.0_f64.to_radians();

impl RandomArm {
    /// Name of the joint whose servo may be wrong: gravity has the largest effect on it.
    pub const WRONG: &str = "j1";

    /// Arm of this seed, whose joint [`WRONG`](Self::WRONG) has a servo that is `wrong` times as stiff as declared. With 1, all
    /// servos differ a little from their declaration.
    pub fn new(seed: u64, wrong: f64) -> Self {
        let mut random = Random(seed);
        let n = random.one_of(&[3, 3, 4]);
        let scale = random.times(2.0);
        let links: Vec<[f64; 3]> = (0..n)
            .map(|i| {
                let length = if i == 0 { 0.06 } else { random.between(0.08, 0.16) };
                let mass = scale * random.between(0.06, 0.2);
                [length, mass, length * random.between(0.3, 0.7)]
            })
            .collect();
        // Largest torque of gravity of each joint: all links beyond it level.
        let loads: Vec<f64> = (0..n)
            .map(|i| {
                let beyond = |k: usize| links[i.max(1)..k].iter().map(|link| link[0]).sum::<f64>();
                (i.max(1)..n).map(|k| links[k][1] * G * (beyond(k) + links[k][2])).sum()
            })
            .collect();
        let largest = loads[1];
        // One type of servo, as on hobby arms, whose servos differ by a percent.
        let sag = random.between(0.05, 0.13);
        let typical = largest / sag;
        let drawn = random.times(1.08);
        let declared = if wrong == 1.0 { drawn } else { 1.0 };
        let friction = 0.07 * largest;
        let joints: Vec<TrueJoint> = (0..n)
            .map(|i| TrueJoint {
                stiffness: typical * random.between(0.99, 1.01),
                coulomb: friction * random.times(2.0),
                viscous: 0.067 * typical * random.times(2.0),
                declared: if i == 1 { declared / wrong } else { declared },
            })
            .collect();
        let urdf = urdf(&links);
        let robot = robot(&mut random, &joints, typical, largest, declared);
        Self {
            joints,
            urdf,
            robot,
            weight_kg: 0.5 * links.iter().map(|link| link[1]).sum::<f64>() / n as f64,
        }
    }

    /// Text of robot.toml.
    pub fn robot_toml(&self) -> &str {
        &self.robot
    }

    /// Same arm with another robot.toml.
    pub fn with_robot(&self, robot: &str) -> Self {
        Self { joints: self.joints.clone(), urdf: self.urdf.clone(), robot: robot.to_owned(), ..*self }
    }

    /// Same arm with true masses that are those of the URDF times `factor`.
    pub fn with_masses(self, factor: f64) -> Self {
        let scale = format!("[simulated]\ntrue_over_nominal.inertia = {factor:?}\n");
        Self { robot: self.robot.replacen("[simulated]\n", &scale, 1), ..self }
    }

    /// Mass that the arm can carry at its tip, kg.
    pub fn weight_kg(&self) -> f64 {
        self.weight_kg
    }

    pub fn definition(&self) -> RobotDefinition {
        let source = |name: &str, text: &str| Source::new(name, text.to_owned());
        RobotDefinition::from_sources(
            source("arm/robot.toml", &self.robot),
            source("arm/arm.urdf", &self.urdf),
        )
        .unwrap_or_else(|error| panic!("{error}\n{}", self.robot))
    }
}

fn urdf(links: &[[f64; 3]]) -> String {
    let shape = |length: f64, radius: f64, origin: &str| {
        format!(
            r#"<collision><origin {origin}/><geometry><cylinder length="{length}" radius="{radius}"/></geometry></collision>"#
        )
    };
    let base = shape(0.06, 0.04, r#"xyz="0 0 0.03""#);
    let mut text = format!(r#"<robot name="arm"><link name="base">{base}</link>"#);
    let mut parent = "base".to_owned();
    let mut at = "0 0 0.1".to_owned();
    for (i, [length, mass, centre]) in links.iter().enumerate() {
        let axis = if i == 0 { "0 0 1" } else { "0 1 0" };
        let limit = if i == 0 { 1.5 } else { 1.8 };
        // A rod, and a motor of some 5 cm.
        let (along, across) = (mass * (length * length / 12.0 + 3e-4), mass * 3e-4);
        let along_x = format!(r#"xyz="{} 0 0" rpy="0 1.5708 0""#, 0.5 * length);
        let body = if i == 0 { String::new() } else { shape(0.8 * length, 0.012, &along_x) };
        let (x, z) = if i == 0 { (0.0, *centre) } else { (*centre, 0.0) };
        let _ = write!(
            text,
            r#"<joint name="j{i}" type="revolute"><parent link="{parent}"/><child link="l{i}"/><origin xyz="{at}"/>
               <axis xyz="{axis}"/><limit lower="-{limit}" upper="{limit}" effort="5" velocity="5"/></joint>
               <link name="l{i}"><inertial><origin xyz="{x} 0 {z}"/><mass value="{mass}"/>
               <inertia ixx="{across}" iyy="{along}" izz="{along}" ixy="0" ixz="0" iyz="0"/></inertial>{body}</link>"#
        );
        parent = format!("l{i}");
        at = if i == 0 { format!("0 0 {length}") } else { format!("{length} 0 0") };
    }
    let _ = write!(
        text,
        r#"<joint name="end" type="fixed"><parent link="{parent}"/><child link="tip"/><origin xyz="{at}"/></joint>
           <link name="tip"/></robot>"#
    );
    text
}

/// robot.toml with the declared servos, and the true ones and the backlash in `[simulated]`.
fn robot(
    random: &mut Random,
    joints: &[TrueJoint],
    typical: f64,
    largest: f64,
    declared_damping: f64,
) -> String {
    let counts = random.one_of(&[2048.0, 4096.0, 8192.0, 16384.0]);
    let resolution = std::f64::consts::TAU / counts;
    let setpoints = random.one_of(&["held", "held", "interpolated"]);
    let (ratio, physics_hz) = random.one_of(&[(10, 5000), (5, 5000), (20, 5000)]);
    let rotor = 0.003 * typical * random.times(2.0) / (200.0 * 200.0);
    let setpoint_resolution = if random.between(0.0, 1.0) < 0.7 { resolution } else { 1e-6 };
    let damping = if random.between(0.0, 1.0) < 0.5 { 0.0 } else { 0.03 * typical };
    let static_over_coulomb = random.between(1.0, 1.2);
    let presliding = random.between(0.002, 0.006);
    let mut text = format!(
        r#"urdf = "arm.urdf"
[interface]
command = "position"
setpoints = "{setpoints}"
gears = "elastic"
on_missed_cycle = "hold-last"
gravity_compensated_by = "controller"
measured = ["position"]
[joint_defaults]
torque_limit_nm = {limit}
velocity_limit_rad_per_s = 5.0
setpoint_resolution_rad = {setpoint_resolution}
rotor = {{ inertia_kg_m2 = {rotor}, gear_ratio = 200.0, encoder_counts_per_turn = {motor_counts} }}
friction = {{ coulomb_nm = {coulomb}, viscous_nms_per_rad = {viscous}, presliding_rad = 0.005 }}
[profile.bus]
servo_hz = 1000.0
servo_ticks_per_cycle = {ratio}
delay_servo_ticks = {delay}
estimator = {{ velocity_filter_hz = 20.0 }}
[safety]
torque_ramp_s = 0.2
tare_s = 0.2
[simulated]
physics_hz = {physics_hz}.0
"#,
        limit = 2.5 * largest,
        motor_counts = (counts / 200.0_f64).ceil(),
        coulomb = 0.07 * largest,
        viscous = 0.067 * typical,
        delay = random.one_of(&[0, 0, 1]),
    );
    let servo = |stiffness: f64, damping: f64| {
        let filter = if damping > 0.0 { ", derivative_filter_hz = 30.0" } else { "" };
        format!("{{ stiffness_nm_per_rad = {stiffness}, damping_nms_per_rad = {damping}{filter} }}")
    };
    for (i, joint) in joints.iter().enumerate() {
        // The declared gains of one type of servo are the same.
        let declared = servo(typical * joint.declared, damping * declared_damping);
        let _ = writeln!(text, "[profile.bus.servo.j{i}]\npid = {declared}");
        let truth = servo(joint.stiffness, damping * declared_damping);
        let _ = writeln!(text, "[simulated.servo.j{i}]\npid = {truth}");
        let TrueJoint { coulomb, viscous, .. } = joint;
        let _ = writeln!(
            text,
            "[simulated.friction.j{i}]\ncoulomb_nm = {coulomb}\nstatic_nm = {}\nviscous_nms_per_rad = {viscous}\n\
             presliding_rad = {presliding}",
            static_over_coulomb * coulomb
        );
        let _ = writeln!(
            text,
            "[simulated.gear.j{i}]\nstiffness_nm_per_rad = {}\ndamping_nms_per_rad = {}\nbacklash_rad = {}",
            25.0 * typical,
            0.025 * typical,
            random.between(0.0, BACKLASH_RAD)
        );
    }
    text
}
