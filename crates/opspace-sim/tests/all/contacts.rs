//! Tests of surfaces with friction against closed forms, and of the energy that they exchange.

use crate::common::object;
use nalgebra::Vector3;
use opspace_backend::SignalRecorder;
use opspace_sim::EnvironmentObject;
use opspace_sim::random::{RngStream, generator};
use rand::RngExt;
use std::f64::consts::TAU;

/// Duration of a step of the plant, s.
const STEP_S: f64 = 5e-5;

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

const ZERO: Vector3<f64> = Vector3::new(0.0, 0.0, 0.0);

/// Returns an object, written as in a task file below its name, at a frame that starts at the origin.
pub fn placed(text: &str) -> EnvironmentObject {
    EnvironmentObject::new(&object(text), ZERO, GRAVITY, generator(1, RngStream::EnvironmentObject(0)))
}

/// Table at z = 0 of 10 kN/m.
fn table(damping: f64, more: &str) -> String {
    format!(
        "[wall]\nframe = 'hand'\npoint_m = [0.3, 0.1, 0.0]\nnormal = [0.0, 0.0, 2.0]\nstiffness_n_per_m = 1e4\n\
         damping_ns_per_m = {damping}\n{more}"
    )
}

/// Returns values of the signals that an object records besides its force.
pub fn recorded(object: &EnvironmentObject) -> Vec<(String, Vec<f64>)> {
    let signals = SignalRecorder::describe(|out| object.record("object", out));
    let mut row = vec![f64::NAN; signals.iter().map(|signal| signal.elements.len()).sum()];
    object.record("object", &mut SignalRecorder::sampling(&mut row));
    let mut rest = row.as_slice();
    signals
        .into_iter()
        .map(|signal| {
            let (values, after) = rest.split_at(signal.elements.len());
            rest = after;
            (signal.name, values.to_vec())
        })
        .collect()
}

/// Closed path about a centre: sines of several frequencies, drawn once, with a period of 1 s.
pub struct ClosedPath {
    center: Vector3<f64>,
    /// Amplitude (m), number of periods and phase of the sines of each axis.
    sines: [Vec<(f64, f64, f64)>; 3],
}

impl ClosedPath {
    /// Draws a path with amplitudes of up to `size` (m) along each axis.
    pub fn draw(seed: u64, center: Vector3<f64>, size: Vector3<f64>) -> Self {
        let mut random = generator(seed, RngStream::EnvironmentObject(7));
        let sines = std::array::from_fn(|axis| {
            (1..=4)
                .map(|k| {
                    let amplitude = size[axis] * random.random_range(0.2..1.0) / f64::from(k);
                    (amplitude, f64::from(k), random.random_range(0.0..TAU))
                })
                .collect()
        });
        Self { center, sines }
    }

    /// Position at a time, m.
    pub fn at(&self, t: f64) -> Vector3<f64> {
        let sum = |sines: &Vec<(f64, f64, f64)>| {
            sines.iter().map(|(a, k, phase)| a * (TAU * k * t + phase).sin()).sum::<f64>()
        };
        self.center + Vector3::from_fn(|axis, _| sum(&self.sines[axis]))
    }

    /// Work (J) of an object on a frame that runs along the path twice, in the second round, and the sum of all work
    /// without its sign.
    pub fn work(&self, object: &mut EnvironmentObject) -> (f64, f64) {
        let steps = (1.0 / STEP_S) as u32;
        let (mut work, mut exchanged) = (0.0, 0.0);
        for k in 0..2 * steps {
            let t = f64::from(k) * STEP_S;
            let [before, after] = [t - 0.5 * STEP_S, t + 0.5 * STEP_S].map(|t| self.at(t));
            let motion = after - before;
            let part = object.force(t, STEP_S, &self.at(t), &(motion / STEP_S)).dot(&motion);
            if k >= steps {
                work += part;
                exchanged += part.abs();
            }
        }
        (work, exchanged)
    }
}

/// Checks closed forms of a bristle: sticking, spring and damper; sliding, Coulomb friction against the motion; the
/// normal force is that without friction.
#[test]
fn friction_sticks_and_slides() {
    let friction = "friction = { coefficient = 0.25, stiffness_n_per_m = 2000.0, damping_ns_per_m = 4.0 }";
    let mut rough = placed(&table(50.0, friction));
    let mut smooth = placed(&table(50.0, ""));
    let depth = Vector3::new(0.0, 0.0, -2e-3);
    // 20 N press: the cone is at 5 N. At 0.05 m/s the damper has 0.2 N while the frame sticks, and none when the anchor
    // slides as fast as the frame.
    let v = Vector3::new(0.03, 0.04, 0.0);
    let mut slid = 0;
    for k in 0..3000 {
        let x = depth + v * (f64::from(k) * STEP_S);
        let force = rough.force(0.0, STEP_S, &x, &v);
        let normal = smooth.force(0.0, STEP_S, &x, &v);
        assert!((normal - Vector3::new(0.0, 0.0, 20.0)).norm() < 1e-12, "{normal}");
        let along = force - normal;
        let stretched = 2000.0 * 0.05 * STEP_S * f64::from(k) + if k > 0 { 4.0 * 0.05 } else { 0.0 };
        let expected = -v.normalize() * stretched.min(5.0);
        assert!((along - expected).norm() < 1e-9, "step {k}: {along} for {expected}");
        slid += u32::from(stretched > 5.0);
    }
    assert!(slid > 1000, "{slid} steps of sliding");
    // The spring of 5 N returns by 2.5 mm: the force on a frame that goes back is zero there.
    let slid_to = depth + v * (2999.0 * STEP_S);
    let back = slid_to - v.normalize() * 2.5e-3;
    let mut force = ZERO;
    for k in 0..=20_000 {
        let share = (f64::from(k) / 10_000.0).min(1.0);
        force = rough.force(0.0, STEP_S, &slid_to.lerp(&back, share), &ZERO);
    }
    assert!(force.xy().norm() < 1e-9, "{force}");
}

/// Checks that friction never leaves its cone and forgets its anchor without contact, on random paths, and that the
/// recorded parts are those of the force.
#[test]
fn friction_stays_in_its_cone() {
    for seed in 0..5 {
        let path = ClosedPath::draw(seed, ZERO, Vector3::new(0.02, 0.02, 2e-3));
        let mut table = placed(&table(30.0, "friction = { coefficient = 0.6 }"));
        let mut contacts = 0;
        for k in 0..20_000 {
            let t = f64::from(k) * STEP_S;
            let v = (path.at(t + STEP_S) - path.at(t)) / STEP_S;
            let force = table.force(t, STEP_S, &path.at(t), &v);
            assert!(force.xy().norm() <= 0.6 * force.z * (1.0 + 1e-12), "{force}");
            let parts = recorded(&table);
            assert_eq!(parts[0], ("object.normal_force".to_owned(), vec![force.z]));
            assert_eq!(parts[1], ("object.friction_force".to_owned(), vec![force.x, force.y, 0.0]));
            contacts += u32::from(force.z > 0.0);
        }
        assert!((1000..19_000).contains(&contacts), "{contacts} steps in contact");
    }
}

/// Work of one round of a closed path: none without damping and friction, negative with either; never positive.
#[test]
fn walls_create_no_energy() {
    // Error of the midpoint rule where contact begins and ends within a step, relative to all work exchanged.
    const RULE: f64 = 1e-3;
    let edge = "edge = { toward = [2.0, 1.0, 0.0], at_m = 0.003 }";
    let friction = "friction = { coefficient = 0.3, damping_ns_per_m = 0.0 }";
    for seed in 0..4 {
        let path = ClosedPath::draw(seed, ZERO, Vector3::new(0.02, 0.02, 2e-3));
        let work = |damping: f64, more: &str| path.work(&mut placed(&table(damping, more)));
        let (elastic, exchanged) = work(0.0, "");
        assert!(elastic.abs() < RULE * exchanged, "{elastic} J of {exchanged} J");
        let mut lossy = vec![work(30.0, ""), work(0.0, friction), work(30.0, friction)];
        lossy.push(work(0.0, &format!("{friction}\n{edge}")));
        for (work, exchanged) in lossy {
            assert!(work < -0.01 * exchanged, "{work} J of {exchanged} J");
        }
        let (work, exchanged) = work(0.0, edge);
        assert!(work < RULE * exchanged, "{work} J of {exchanged} J");
    }
}

/// Work of a bristle alone, at a constant normal force: the implicit step returns no energy, to rounding, at any speed.
#[test]
fn bristles_create_no_energy_at_any_step() {
    for (seed, size) in (0..).zip([1e-5, 1e-4, 1e-3, 1e-2, 0.1]) {
        let path = ClosedPath::draw(seed, Vector3::new(0.0, 0.0, -1e-3), Vector3::new(size, size, 0.0));
        for damping in [0.0, 10.0] {
            let friction = format!(
                "friction = {{ coefficient = 0.4, stiffness_n_per_m = 3e4, damping_ns_per_m = {damping} }}"
            );
            let mut table = placed(&table(0.0, &friction));
            let steps = 400_u32;
            let (mut before, mut work, mut exchanged) = (path.at(0.0), 0.0, 0.0);
            for k in 0..=3 * steps {
                let x = path.at(f64::from(k) / f64::from(steps));
                let part = table.force(0.0, STEP_S, &x, &ZERO).dot(&(x - before));
                before = x;
                work += part;
                exchanged += f64::abs(part);
                assert!(work <= 1e-12 * exchanged, "{work} J of {exchanged} J after {k} steps");
            }
        }
    }
}

/// Checks that a frame leaves a wall at its edge, and meets the side when it comes back below the surface.
#[test]
fn wall_ends_at_its_edge() {
    let mut table = placed(&table(0.0, "edge = { toward = [2.0, 0.0, 0.0], at_m = 0.5 }"));
    let mut force = |x: f64, z: f64| table.force(0.0, STEP_S, &Vector3::new(x, 0.7, z), &ZERO);
    assert_eq!(force(0.4, 0.001), ZERO, "above");
    assert!((force(0.4, -0.001).z - 10.0).abs() < 1e-12, "on the table");
    assert!((force(0.499, -0.001).z - 10.0).abs() < 1e-12, "at the edge");
    assert_eq!(force(0.501, -0.001), ZERO, "beyond the edge");
    let side = force(0.498, -0.001);
    assert!((side - Vector3::new(20.0, 0.0, 0.0)).norm() < 1e-9, "{side}");
    assert_eq!(force(0.498, 0.001), ZERO, "above again");
    assert!((force(0.498, -0.002).z - 20.0).abs() < 1e-9, "on the table again");
}

/// Compared: force on a cylinder, and its definition; far along the axis too. Steady sliding around it.
#[test]
fn cylinder_pushes_outwards() {
    let text = |friction: &str| {
        format!(
            "[cylinder]\nframe = 'hand'\npoint_m = [0.3, 0.0, -0.2]\naxis = [0.0, 3.0, 0.0]\nradius_m = 0.05\n\
             stiffness_n_per_m = 1e4\ndamping_ns_per_m = 20.0\n{friction}"
        )
    };
    let mut smooth = placed(&text(""));
    for (angle, y) in [(0.3_f64, -4.0), (2.0, 0.0), (-1.0, 0.7)] {
        let outward = Vector3::new(angle.cos(), 0.0, angle.sin());
        let mut at = |radius: f64, v: Vector3<f64>| {
            smooth.force(0.0, STEP_S, &(Vector3::new(0.3, y, -0.2) + outward * radius), &v)
        };
        assert_eq!(at(0.0501, ZERO), ZERO);
        assert!((at(0.049, ZERO) - outward * 10.0).norm() < 1e-9);
        assert!((at(0.049, outward * -0.1) - outward * 12.0).norm() < 1e-9);
        assert_eq!(at(0.049, outward), ZERO, "it never pulls");
    }
    // Around the cylinder at a depth of 1 mm: 10 N, and 2 N against the motion.
    let mut rough = placed(&text("friction = { coefficient = 0.2 }"));
    for k in 0..40_000 {
        let (sine, cosine) = (f64::from(k) * 1e-4).sin_cos();
        let outward = Vector3::new(cosine, 0.0, sine);
        let force = rough.force(0.0, STEP_S, &(Vector3::new(0.3, 0.0, -0.2) + outward * 0.049), &ZERO);
        if k > 1000 {
            let expected = outward * 10.0 - Vector3::new(-sine, 0.0, cosine) * 2.0;
            // The anchor follows at the angle of its deflection, 0.2 mm.
            assert!((force - expected).norm() < 1e-3, "{force} for {expected}");
        }
    }
    let path = |seed| ClosedPath::draw(seed, Vector3::new(0.345, 0.0, -0.2), Vector3::new(0.01, 0.03, 0.03));
    for seed in 0..4 {
        let (work, exchanged) = path(seed).work(&mut placed(&text("").replace("20.0", "0.0")));
        assert!(work.abs() < 1e-3 * exchanged && exchanged > 1e-3, "{work} J of {exchanged} J");
        let (work, exchanged) = path(seed).work(&mut placed(&text("friction = { coefficient = 0.2 }")));
        assert!(work < -0.01 * exchanged, "{work} J of {exchanged} J");
    }
}

/// Table at z = 0 with a hole of 10 mm radius for a peg of 9.9 mm at x = 0.4 m.
fn hole(more: &str) -> String {
    format!(
        "[hole]\nframe = 'hand'\npoint_m = [0.4, 0.0, 0.0]\nnormal = [0.0, 0.0, 1.0]\nradius_m = 0.01\nclearance_m = 1e-4\n\
         depth_m = 0.02\nstiffness_n_per_m = 5e4\ndamping_ns_per_m = 0.0\n{more}"
    )
}

/// Compared: the forces of plane, wall and bottom, and their definitions: the peg rests on the plane until it is within the
/// clearance, and stays in the hole until it is above the plane.
#[test]
fn peg_rests_drops_and_is_held() {
    let mut hole = placed(&hole(""));
    let mut at = |offset: f64, depth: f64| {
        let force = hole.force(0.0, STEP_S, &Vector3::new(0.4 + offset * 0.6, offset * 0.8, -depth), &ZERO);
        (force.x * 0.6 + force.y * 0.8, force.z, recorded(&hole)[2].1[0])
    };
    let near = |(x, z, depth): (f64, f64, f64), expected: (f64, f64, f64)| {
        let error = (x - expected.0).abs() + (z - expected.1).abs() + (depth - expected.2).abs();
        assert!(error < 1e-9, "{x} N, {z} N, {depth} m for {expected:?}");
    };
    near(at(5e-3, -1e-3), (0.0, 0.0, 0.0));
    // 20 N on the plane, up to the clearance.
    for offset in [5e-3, 1e-3, 2e-4, 1.01e-4] {
        near(at(offset, 4e-4), (0.0, 20.0, 0.0));
    }
    near(at(0.9e-4, 4e-4), (0.0, 0.0, 4e-4));
    near(at(0.5e-4, 0.01), (0.0, 0.0, 0.01));
    // 0.2 mm into the wall, half a millimetre into the bottom, and both.
    near(at(3e-4, 0.01), (-10.0, 0.0, 0.01));
    near(at(0.0, 0.0205), (0.0, 25.0, 0.0205));
    near(at(3e-4, 0.0205), (-10.0, 25.0, 0.0205));
    // On the way out the wall ends at the plane.
    near(at(3e-4, 1e-4), (-10.0, 0.0, 1e-4));
    near(at(3e-4, -1e-6), (0.0, 0.0, 0.0));
    near(at(3e-4, 1e-4), (0.0, 5.0, 0.0));
}

/// Compared: force on a chamfer of 45°, and its definition: half as stiff along the axis as the plane, and as large inwards.
#[test]
fn chamfer_leads_the_peg_inwards() {
    let mut hole = placed(&hole("chamfer_m = 1e-3"));
    let mut at =
        |offset: f64, depth: f64| hole.force(0.0, STEP_S, &Vector3::new(0.4 + offset, 0.0, -depth), &ZERO);
    assert!((at(2e-3, 1e-4) - Vector3::new(0.0, 0.0, 5.0)).norm() < 1e-9, "the plane");
    assert_eq!(at(6e-4, 4.9e-4), ZERO, "above the chamfer");
    let force = at(6e-4, 7e-4);
    assert!((force - Vector3::new(-5.0, 0.0, 5.0)).norm() < 1e-9, "{force}");
    assert_eq!(at(0.9e-4, 5e-3), ZERO, "in the hole");
    let force = at(2e-4, 5e-3);
    assert!((force - Vector3::new(-5.0, 0.0, 0.0)).norm() < 1e-9, "{force}");
}

/// Checks that a peg which is pressed on the plane with a spring finds the hole along a spiral, and not before it is within
/// the clearance.
#[test]
fn spiral_search_finds_the_hole() {
    let mut hole =
        placed(&hole("friction = { coefficient = 0.2 }").replace("ns_per_m = 0.0", "ns_per_m = 200.0"));
    // A peg of 1 kg on a spring of 5 kN/m, whose other end moves outwards by 0.15 mm per turn, 2 mm below the plane.
    let start = Vector3::new(0.4 + 1e-3, -0.8e-3, 0.0);
    let (mut x, mut v, mut dropped) = (start, ZERO, None);
    for k in 0..800_000 {
        let turns = f64::from(k) * STEP_S * 0.5;
        let target = start
            + Vector3::new((TAU * turns).cos(), (TAU * turns).sin(), 0.0) * (0.15e-3 * turns)
            + Vector3::new(0.0, 0.0, -2e-3);
        let force = (target - x) * 5e3 - v * 100.0 + hole.force(0.0, STEP_S, &x, &v);
        v += force * STEP_S;
        x += v * STEP_S;
        let depth = recorded(&hole)[2].1[0];
        if depth > 0.0 && dropped.is_none() {
            let offset = (x - Vector3::new(0.4, 0.0, 0.0)).xy().norm();
            assert!(offset <= 1e-4 + 2.0 * v.norm() * STEP_S, "dropped {offset} m beside the hole");
            dropped = Some(turns);
        }
        if depth > 1.9e-3 {
            assert!(turns > 2.0, "the hole is not at the start: {turns} turns");
            return;
        }
    }
    panic!("the peg is at {x} after the search, dropped after {dropped:?} turns");
}

/// Work on a peg along closed paths that cross rim, wall and bottom: never positive.
#[test]
fn holes_create_no_energy() {
    let friction = "friction = { coefficient = 0.3 }";
    for seed in 0..6 {
        let path = ClosedPath::draw(seed, Vector3::new(0.4, 0.0, -5e-3), Vector3::new(3e-4, 3e-4, 1.3e-2));
        for more in ["", "chamfer_m = 1e-3"] {
            let (work, exchanged) = path.work(&mut placed(&hole(more)));
            assert!(work < 1e-3 * exchanged && exchanged > 1e-3, "{work} J of {exchanged} J");
            let (work, exchanged) = path.work(&mut placed(&hole(&format!("{more}\n{friction}"))));
            assert!(work < -0.01 * exchanged, "{work} J of {exchanged} J");
        }
    }
}
