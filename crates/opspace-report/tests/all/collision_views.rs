//! Collision geometry on the page of a run: the arm and its obstacles are drawn to scale, at the positions in the log.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::report::{NASTY, points, texts, xml};
use crate::run_figures::{load, shown};
use nalgebra::Vector3;
use opspace_backend::CommandKind;
use opspace_backend::signal_names::{LEAST_DISTANCE, PHASE, Q, TICK_CHANNEL};
use opspace_experiment::metrics::columns::default_columns;
use opspace_loop::Phase;
use opspace_model::collision::{
    Capsule, CollisionData, CollisionShape, HalfSpace, LinkCapsule, collision_distances,
};
use opspace_model::{Data, forward_kinematics, frame_placement};
use opspace_report::document::{
    ClosestPair, CollisionMoment, EnvironmentShape, PlacedObject, PlacedShape, page,
};
use opspace_report::html::Page;

/// Rounding of coordinates and distances of an arm, m.
const ROUNDING_M: f64 = 1e-12;

/// Rounding of a coordinate on the canvas, units: two ends of a length, each to an integer.
const PIXELS: f64 = 2.0;

/// Compared: the capsules of each moment with those of robot.toml, placed by the frames of their links at the logged joint
/// positions; the obstacles with those of the task file; the least distance with that of all control cycles, computed by
/// `collision_distances`, and with the one that the controller logged.
#[test]
fn moments_are_those_of_the_logged_positions() {
    let experiment = load("panda-obstacles", CommandKind::Torque, 1.6);
    let ((rows, _), section) = shown(&experiment);
    let (model, geometry) =
        (&experiment.robot().model, &experiment.kept_distances().unwrap().limits.geometry);
    let tick = rows.channel(TICK_CHANNEL).unwrap();
    let [q, phase, logged] = [Q, PHASE, LEAST_DISTANCE].map(|name| tick.signal(name).unwrap());
    let idle = [Phase::Rest, Phase::Stopped].map(Phase::code);
    let controlled: Vec<usize> = (0..tick.len()).filter(|k| !idle.contains(&phase.row(*k)[0])).collect();
    let start_s = tick.time_s[controlled[0]];
    let (mut data, mut distances) = (Data::new(model), CollisionData::new(geometry));
    let mut distance_m = |q: &[f64]| {
        forward_kinematics(model, &mut data, q);
        collision_distances(geometry, model, &data, f64::INFINITY, &mut distances);
        distances.near().map(|(_, proximity)| proximity.distance_m).fold(f64::INFINITY, f64::min)
    };
    let least = |a: &&usize, b: &&usize| distance_m(q.row(**a)).total_cmp(&distance_m(q.row(**b)));
    let closest = *controlled.iter().min_by(least).unwrap();
    let expected = [controlled[0], closest, *controlled.last().unwrap()];
    let names: Vec<&str> = section.collisions.iter().map(|moment| moment.name.as_str()).collect();
    assert_eq!(names, ["start", "least distance", "end"]);
    for (moment, k) in section.collisions.iter().zip(expected) {
        assert_eq!(moment.time_s, tick.time_s[k] - start_s, "{}", moment.name);
        let pair = moment.closest.unwrap();
        assert!((pair.distance_m - distance_m(q.row(k))).abs() < ROUNDING_M, "{}", moment.name);
        assert!((pair.distance_m - logged.row(k)[0]).abs() < ROUNDING_M, "{}", moment.name);
        let [a, b] = pair.points_m;
        assert!(((a - b).norm() - pair.distance_m).abs() < ROUNDING_M, "{}", moment.name);
        assert_ne!(pair.shapes[0], pair.shapes[1]);
        let mut data = Data::new(model);
        forward_kinematics(model, &mut data, q.row(k));
        let (obstacles, links): (Vec<&PlacedShape>, Vec<&PlacedShape>) =
            moment.shapes.iter().partition(|shape| shape.is_obstacle);
        assert_eq!(links.len(), experiment.robot().capsules().len());
        for (shape, LinkCapsule { name, link, start_m, end_m, radius_m, .. }) in
            links.iter().zip(experiment.robot().capsules())
        {
            let place = frame_placement(model, &data, model.frame_id(link).unwrap());
            let CollisionShape::Capsule(capsule) = shape.shape else { panic!("{name} is a capsule") };
            assert_eq!((&shape.name, capsule.radius_m), (name, *radius_m));
            for (drawn, own) in [(capsule.start_m, start_m), (capsule.end_m, end_m)] {
                let off = (drawn - place.act_point(&Vector3::from(*own))).norm();
                assert!(off < ROUNDING_M, "{}: {name} is off by {off} m", moment.name);
            }
        }
        let [ball, post, table] = &obstacles[..] else { panic!("three obstacles") };
        assert_eq!([&ball.name, &post.name, &table.name], ["ball", "post", "table"]);
        let sphere = Capsule::sphere(Vector3::new(0.32, 0.2, 0.44), 0.05);
        assert_eq!(ball.shape, CollisionShape::Capsule(sphere));
        let plane = HalfSpace { normal: Vector3::z(), offset_m: 0.0 };
        assert_eq!(table.shape, CollisionShape::HalfSpace(plane));
    }
    let html = page(
        "t",
        "l",
        std::slice::from_ref(&section.summary),
        &default_columns(&[]),
        std::slice::from_ref(&section),
    );
    // The links of the arm come first.
    assert_eq!(html.matches("<p class=\"moment\">").count(), 4);
    assert!(html.contains("Collision geometry.</b>") && html.contains("and ball are closest: "), "{html}");
}

/// Compared: the links of a robot without `[collision]`, and its frames at the first row, at the row with the hand farthest from its
/// start, and at the last row of the log.
#[test]
fn links_are_drawn_at_the_start_farthest_from_it_and_at_the_end() {
    let experiment = load("cartesian-tracking", CommandKind::Torque, 3.0);
    let ((rows, _), section) = shown(&experiment);
    assert!(section.collisions.is_empty());
    let tick = rows.channel(TICK_CHANNEL).unwrap();
    let [q, phase] = [Q, PHASE].map(|name| tick.signal(name).unwrap());
    let idle = [Phase::Rest, Phase::Stopped].map(Phase::code);
    let controlled: Vec<usize> = (0..tick.len()).filter(|k| !idle.contains(&phase.row(*k)[0])).collect();
    let model = &experiment.robot().model;
    let mut data = Data::new(model);
    let mut hand = |k: usize| {
        forward_kinematics(model, &mut data, q.row(k));
        frame_placement(model, &data, model.frame_id("hand").unwrap()).translation
    };
    let start = hand(controlled[0]);
    let farthest =
        controlled.iter().map(|k| hand(*k)).max_by(|a, b| (a - start).norm().total_cmp(&(b - start).norm()));
    let expected = [start, farthest.unwrap(), hand(*controlled.last().unwrap())];
    assert!((expected[1] - start).norm() > 0.02);
    let arm = section.arm.as_ref().unwrap();
    for (moment, expected) in expected.iter().enumerate() {
        let links = arm.shapes.iter().filter(|shape| shape.moment == moment);
        let off = links.map(|shape| match shape.shape {
            CollisionShape::Capsule(capsule) => (capsule.end_m - expected).norm(),
            CollisionShape::HalfSpace(_) => f64::INFINITY,
        });
        assert!(off.fold(f64::INFINITY, f64::min) < ROUNDING_M, "moment {moment}");
    }
    let html = page(
        "t",
        "l",
        std::slice::from_ref(&section.summary),
        &default_columns(&[]),
        std::slice::from_ref(&section),
    );
    assert!(!html.contains("Collision geometry") && html.contains("Arm.</b>"), "no heading");
    assert!(html.contains("arm, farthest from the start") && html.contains("arm at the end"));
}

fn shape(name: &str, is_obstacle: bool, shape: CollisionShape) -> PlacedShape {
    PlacedShape { name: name.to_owned(), is_obstacle, moment: 0, shape }
}

fn sphere(center: [f64; 3], radius_m: f64) -> CollisionShape {
    CollisionShape::Capsule(Capsule::sphere(center.into(), radius_m))
}

/// Ends of a moment's first and second sphere, m.
const CENTERS: [[f64; 3]; 2] = [[0.1, -0.3, 0.2], [0.45, 0.2, 0.9]];

/// Two spheres of an arm, and obstacles: one that is far away, an oblique half-space, and the floor.
fn moment() -> CollisionMoment {
    let half_space = |normal: [f64; 3], offset_m| {
        CollisionShape::HalfSpace(HalfSpace { normal: Vector3::from(normal).normalize(), offset_m })
    };
    let shapes = vec![
        shape("first", false, sphere(CENTERS[0], 0.1)),
        shape("second", false, sphere(CENTERS[1], 0.05)),
        shape("far", true, sphere([30.0, 0.0, 0.0], 0.1)),
        shape("ramp", true, half_space([1.0, 1.0, 1.0], -0.2)),
        shape(NASTY, true, half_space([0.0, 0.0, 1.0], 0.0)),
    ];
    let points_m = [Vector3::from(CENTERS[0]), Vector3::from(CENTERS[1])];
    let closest = Some(ClosestPair { shapes: [0, 4], distance_m: -0.0123, points_m });
    CollisionMoment {
        name: "start".to_owned(),
        time_s: 0.5,
        shapes,
        closest,
        environment: Vec::new(),
        is_sketch: false,
    }
}

/// Compared: distances between the centres of two spheres on the canvas with those of their projections, in the unit of a
/// radius on the canvas. Upwards is negative on a canvas.
#[test]
fn spheres_are_drawn_to_scale() {
    let html = Page::new("t").collisions(&[moment()]).render();
    let document = xml(&html);
    let figure = document.descendants().find(|node| node.attribute("class") == Some("row")).unwrap();
    let views: Vec<_> = figure.children().filter(|node| node.tag_name().name() == "svg").collect();
    assert_eq!(views.len(), 3);
    let mut scales = Vec::new();
    for (view, [right, up]) in views.iter().zip([[0, 2], [1, 2], [0, 1]]) {
        let polygons = view.descendants().filter(|node| node.tag_name().name() == "polygon");
        let mut boxes: Vec<[f64; 4]> = polygons.map(|polygon| bounds(&points(&polygon))).collect();
        // The floor is seen in the views from the side; it is not as high as it is wide.
        let is_round = |[left, right, top, bottom]: &[f64; 4]| (right - left - bottom + top).abs() < PIXELS;
        let floors = boxes.iter().filter(|polygon| !is_round(polygon)).count();
        assert_eq!(floors, usize::from(up == 2));
        boxes.retain(is_round);
        boxes.sort_by(|a, b| (b[1] - b[0]).total_cmp(&(a[1] - a[0])));
        let [first, second] = boxes[..] else { panic!("two spheres in a view, not {}", boxes.len()) };
        let per_m = (first[1] - first[0]) / 0.2;
        assert!((second[1] - second[0] - 0.1 * per_m).abs() < PIXELS, "{second:?}");
        let middle = |[left, right, top, bottom]: [f64; 4]| [0.5 * (left + right), 0.5 * (top + bottom)];
        let moved = [0, 1].map(|i| middle(second)[i] - middle(first)[i]);
        let expected = [(right, 1.0), (up, -1.0)]
            .map(|(axis, sign)| sign * per_m * (CENTERS[1][axis] - CENTERS[0][axis]));
        // The scale is known from a length of a fifth of a metre.
        for (moved, expected) in moved.iter().zip(expected) {
            assert!((moved - expected).abs() < 5.0 * PIXELS, "{moved} for {expected}");
        }
        scales.push(per_m);
    }
    assert!(scales.iter().all(|scale| (scale - scales[0]).abs() < 5.0 * PIXELS), "{scales:?}");
}

/// Checks units, axes, names, and what is said of shapes that are not drawn; a name of any characters is text.
#[test]
fn views_say_what_they_show() {
    let html = Page::new("t").collisions(&[moment()]).render();
    let document = xml(&html);
    let texts = texts(&document);
    for (text, count) in [
        ("x (m)", 2),
        ("y (m)", 2),
        ("z (m)", 2),
        ("side view, from −y", 1),
        ("front view, from +x", 1),
        ("top view, from +z", 1),
    ] {
        assert_eq!(texts.iter().filter(|found| *found == text).count(), count, "{text}: {texts:?}");
    }
    let all: String = document.descendants().filter_map(|node| node.text()).collect();
    assert!(all.contains("Start, at 0.5 s: first and a <b> & \"c\""), "{all}");
    assert!(all.contains("penetrate each other by 12.3 mm."), "{all}");
    assert!(all.contains("In no view: far, ramp."), "{all}");
    for name in ["arm", "obstacle", "closest pair"] {
        assert!(html.contains(&format!("</svg> {name}</span>")), "{name}");
    }
    assert_eq!(Page::new("t").collisions(&[]).render(), Page::new("t").render());
}

/// Left, right, top and bottom of a polygon.
fn bounds(points: &[(f64, f64)]) -> [f64; 4] {
    let of = |pick: fn(&(f64, f64)) -> f64| {
        let values = || points.iter().map(pick);
        [values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max)]
    };
    let ([left, right], [top, bottom]) = (of(|point| point.0), of(|point| point.1));
    [left, right, top, bottom]
}

/// Returns the extent of each polygon of a view in metres: left, right, bottom, top, relative to the corner of the view. The
/// view is as large as its largest polygon, a wall that fills it.
fn extents(html: &str, view: usize) -> Vec<[f64; 4]> {
    let document = xml(html);
    let row = document.descendants().find(|node| node.attribute("class") == Some("row")).unwrap();
    let view = row.children().filter(|node| node.tag_name().name() == "svg").nth(view).unwrap();
    let polygons = view.descendants().filter(|node| node.tag_name().name() == "polygon");
    polygons
        .map(|polygon| {
            let [left, right, top, bottom] = bounds(&points(&polygon));
            [left, right, -bottom, -top]
        })
        .collect()
}

/// Compared: the outlines of a table with an edge, a cylinder, and a hole in a second table, and their sizes, in the unit of a
/// sphere on the canvas.
#[test]
fn environment_is_drawn_to_scale() {
    let plane = |offset_m, edge| EnvironmentShape::Plane {
        below: HalfSpace { normal: Vector3::z(), offset_m },
        edge,
    };
    let object = |shape| PlacedObject { name: "thing".to_owned(), shape };
    let drawn = |environment: Vec<PlacedObject>| {
        let shapes = vec![shape("link", false, sphere([0.0, 0.0, 0.5], 0.5))];
        let moment = CollisionMoment {
            name: "start".to_owned(),
            time_s: 0.0,
            shapes,
            closest: None,
            environment,
            is_sketch: true,
        };
        Page::new("t").collisions(&[moment]).render()
    };
    let near = |a: f64, b: f64| assert!((a - b).abs() < 2.0 * PIXELS, "{a} for {b}");
    // Left, right, bottom and top of a polygon, m from the corner of the box around the sphere of 1 m.
    let within = |polygon: [f64; 4], link: [f64; 4], expected: [f64; 4]| {
        let per_m = link[1] - link[0];
        for (i, corner) in [link[0], link[0], link[2], link[2]].into_iter().enumerate() {
            near(polygon[i], corner + expected[i] * per_m);
        }
    };
    // The table ends at x = 0.25 m: three quarters of the sphere, seen from the side, and from above.
    let edge = HalfSpace { normal: Vector3::x(), offset_m: 0.25 };
    let html = drawn(vec![object(plane(0.1, Some(edge)))]);
    for view in 0..3 {
        assert_eq!(extents(&html, view).len(), 2, "view {view}");
    }
    let [table, link] = extents(&html, 0)[..] else { panic!("two polygons") };
    let per_m = link[1] - link[0];
    near(table[1], link[0] + 0.75 * per_m);
    near(table[3], link[2] + 0.1 * per_m);
    let [table, link] = extents(&html, 2)[..] else { panic!("two polygons") };
    near(table[1], link[0] + 0.75 * per_m);
    // Along its axis a cylinder is a circle, across it a strip.
    let cylinder = EnvironmentShape::Cylinder {
        point_m: Vector3::new(0.1, 7.0, 0.6),
        axis: Vector3::y(),
        radius_m: 0.2,
    };
    let html = drawn(vec![object(cylinder)]);
    let [circle, link] = extents(&html, 0)[..] else { panic!("two polygons") };
    within(circle, link, [0.4, 0.8, 0.4, 0.8]);
    let [strip, link] = extents(&html, 2)[..] else { panic!("two polygons") };
    near(strip[0], link[0] + 0.4 * per_m);
    near(strip[1], link[0] + 0.8 * per_m);
    assert!(strip[2] < link[2] && strip[3] > link[3], "without ends");
    // A hole of 0.1 m radius and 0.3 m depth.
    let rod = EnvironmentShape::Rod { ends_m: [Vector3::z() * 0.4, Vector3::z() * 0.1], radius_m: 0.1 };
    let html = drawn(vec![object(plane(0.4, None)), object(rod)]);
    let [_, hole, link] = extents(&html, 1)[..] else { panic!("three polygons") };
    within(hole, link, [0.4, 0.6, 0.1, 0.4]);
    assert_eq!(extents(&html, 2).len(), 2, "from above the hole alone");
    assert!(html.contains("Arm and environment.</b>") && html.contains("</svg> environment</span>"));
}

/// Checks that a robot without `[collision]` is drawn with the walls of its environment, and its last line ends at the hand.
#[test]
fn arm_without_collision_geometry_is_drawn_with_its_environment() {
    let experiment = load("press-wall", CommandKind::Torque, 0.4);
    let ((rows, _), section) = shown(&experiment);
    let moment = section.arm.as_ref().unwrap();
    assert_eq!(moment.name, "start and end");
    let tick = rows.channel(TICK_CHANNEL).unwrap();
    let phase = tick.signal(PHASE).unwrap();
    let first = (0..tick.len()).find(|k| phase.row(*k)[0] != Phase::Rest.code()).unwrap();
    let model = &experiment.robot().model;
    let mut data = Data::new(model);
    forward_kinematics(model, &mut data, tick.signal(Q).unwrap().row(first));
    let hand = frame_placement(model, &data, model.frame_id("hand").unwrap()).translation;
    assert!(moment.is_sketch && moment.closest.is_none());
    let ends = moment.shapes.iter().map(|shape| match shape.shape {
        CollisionShape::Capsule(capsule) => (capsule.end_m - hand).norm(),
        CollisionShape::HalfSpace(_) => f64::INFINITY,
    });
    assert!(ends.fold(f64::INFINITY, f64::min) < ROUNDING_M, "{hand}");
    let below = HalfSpace { normal: -Vector3::x(), offset_m: -0.37 };
    assert_eq!(moment.environment[0].shape, EnvironmentShape::Plane { below, edge: None });
}
