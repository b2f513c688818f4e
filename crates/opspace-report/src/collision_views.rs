//! Views of arm, obstacles and environment as inline SVG, from three sides, at each moment of a run.

use crate::collision_moments::{ClosestPair, CollisionMoment, PlacedShape};
use crate::environment_shapes::{EnvironmentShape, PlacedObject};
use crate::figure::{Axis, Chart, Drawn, INK, PALETTE, canvas, chart, escape, printable, px, text};
use crate::polygon::{cut, on, within};
use nalgebra::{Vector2, Vector3};
use opspace_experiment::text::{capitalised, format_short};
use opspace_model::collision::{Capsule, CollisionShape, HalfSpace};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::f64::consts::{FRAC_PI_2, PI};
use std::fmt::Write as _;

/// Length of both axes of a view on the canvas.
const SIDE: i32 = px(270);
/// Space for the labels to the left of a view, as for those of other figures above, below and to the right.
const LEFT: i32 = px(62);
const BESIDE: i32 = LEFT + px(20);
const ABOVE_AND_BELOW: i32 = px(28 + 43);

/// Distance from the arm up to which obstacles are in the views, relative to the largest side of the box around the arm.
const NEAR: f64 = 0.25;
/// Empty space around the contents of a view, relative to their size.
const PADDING: f64 = 0.04;
/// Number of corners with which half a circle is drawn.
const CORNERS: usize = 20;
/// Component of a normal across a view up to which its plane is seen edge-on.
const EDGE_ON: f64 = 1e-6;
/// Opacity of shapes, so that those behind remain visible.
const OPACITY: f64 = 0.22;

/// Parallel projection along an axis of the world.
struct View {
    name: &'static str,
    /// Axes of the world to the right and upwards.
    axes: [usize; 2],
    /// Axis of the world along which the viewer looks, and the side of the viewer on it.
    depth: (usize, f64),
}

const VIEWS: [View; 3] = [
    View { name: "side view, from −y", axes: [0, 2], depth: (1, -1.0) },
    View { name: "front view, from +x", axes: [1, 2], depth: (0, 1.0) },
    View { name: "top view, from +z", axes: [0, 1], depth: (2, 1.0) },
];

const AXES: [&str; 3] = ["x (m)", "y (m)", "z (m)"];

/// Part that a shape plays, with its name in the legend and its colour.
#[derive(Clone, Copy, PartialEq)]
enum Role {
    Arm,
    ArmFarthest,
    ArmAtEnd,
    Obstacle,
    Closest,
    Environment,
}

impl Role {
    const ALL: [(Self, &str); 6] = [
        (Self::Arm, "arm"),
        (Self::ArmFarthest, "arm, farthest from the start"),
        (Self::ArmAtEnd, "arm at the end"),
        (Self::Obstacle, "obstacle"),
        (Self::Closest, "closest pair"),
        (Self::Environment, "environment"),
    ];

    fn of(moment: &CollisionMoment, shape: usize) -> Self {
        match &moment.closest {
            Some(closest) if closest.shapes.contains(&shape) => Self::Closest,
            _ if moment.shapes[shape].is_obstacle => Self::Obstacle,
            _ => [Self::Arm, Self::ArmFarthest, Self::ArmAtEnd][moment.shapes[shape].moment.min(2)],
        }
    }

    fn color(self) -> RGBColor {
        match self {
            Self::Arm => PALETTE[0].0,
            Self::ArmFarthest => PALETTE[4].0,
            Self::ArmAtEnd => PALETTE[5].0,
            Self::Obstacle => PALETTE[2].0,
            Self::Closest => PALETTE[1].0,
            Self::Environment => PALETTE[3].0,
        }
    }
}

/// Legend, views and text of each moment as HTML; the views of a moment are in an element of class `row`.
pub(crate) fn views(moments: &[CollisionMoment]) -> String {
    let part = Part::around(moments);
    let is_used = |role: Role| {
        moments.iter().any(|moment| match role {
            Role::Environment => !moment.environment.is_empty(),
            _ => (0..moment.shapes.len()).any(|shape| Role::of(moment, shape) == role),
        })
    };
    let mut html = String::from("<p class=\"legend\">");
    for (role, name) in Role::ALL.into_iter().filter(|(role, _)| is_used(*role)) {
        let RGBColor(r, g, b) = role.color();
        // Writing to a String cannot fail.
        let _ = write!(
            html,
            "<span><svg viewBox=\"0 0 28 14\" aria-hidden=\"true\"><rect x=\"1\" y=\"1\" width=\"26\" height=\"12\" rx=\"6\" \
             fill=\"#{r:02X}{g:02X}{b:02X}\" fill-opacity=\"{OPACITY}\" stroke=\"#{r:02X}{g:02X}{b:02X}\" \
             stroke-width=\"1.5\"/></svg> {name}</span> "
        );
    }
    html += "</p>\n";
    for moment in moments {
        let drawings: String = VIEWS.iter().map(|view| view.svg(moment, &part)).collect();
        let _ = writeln!(
            html,
            "<p class=\"moment\">{}</p>\n<div class=\"row\">{drawings}</div>",
            escape(&sentence(moment))
        );
    }
    html
}

/// Title of the views.
pub(crate) fn title(moments: &[CollisionMoment]) -> &'static str {
    let has_environment = moments.iter().any(|moment| !moment.environment.is_empty());
    match moments.iter().any(|moment| moment.is_sketch) {
        true if has_environment => "Arm and environment",
        true => "Arm",
        false => "Collision geometry",
    }
}

/// Caption of the views.
pub(crate) fn caption(moments: &[CollisionMoment]) -> String {
    let shapes = || moments.first().into_iter().flat_map(|moment| &moment.shapes);
    let objects = || moments.first().into_iter().flat_map(|moment| &moment.environment);
    let is_sketch = moments.iter().any(|moment| moment.is_sketch);
    let contents = if is_sketch && objects().next().is_none() {
        "Links as lines between joints and frames"
    } else if is_sketch {
        "Links as lines between joints and frames, and the objects of the environment"
    } else if objects().next().is_some() {
        "Capsules of the arm, obstacles, and the objects of the environment"
    } else {
        "Capsules of the arm, and obstacles"
    };
    let mut text = format!(
        "{contents}, at the measured joint positions: parallel projections of equal scale, in world axes."
    );
    if moments.iter().any(|moment| moment.closest.is_some()) {
        text += " A line joins the closest points of the pairs that are kept apart.";
    }
    if objects().any(|object| matches!(object.shape, EnvironmentShape::Plane { .. })) {
        text += " Walls are drawn where they are seen edge-on, and their edges also from above.";
    }
    if shapes().any(|shape| matches!(shape.shape, CollisionShape::HalfSpace(_))) {
        text += " Half-spaces are drawn where their plane is seen edge-on.";
    }
    let part = Part::around(moments);
    let is_drawn = |shape: &PlacedShape| VIEWS.iter().any(|view| view.outline(&shape.shape, &part).len() > 2);
    // A hole is seen with its plane or without.
    let is_seen = |name: &str| {
        let mut parts = objects().filter(|object| object.name == name);
        parts.any(|object| VIEWS.iter().any(|view| view.outline_of_object(object, &part).len() > 2))
    };
    let mut hidden: Vec<&str> = (shapes().filter(|shape| !is_drawn(shape)).map(|shape| shape.name.as_str()))
        .chain(objects().map(|object| object.name.as_str()).filter(|name| !is_seen(name)))
        .collect();
    hidden.dedup();
    if !hidden.is_empty() {
        text += &format!(" In no view: {}.", hidden.join(", "));
    }
    text
}

/// Time of a moment, and its closest pair.
fn sentence(moment: &CollisionMoment) -> String {
    let name = capitalised(&moment.name);
    if moment.is_sketch {
        return format!("{name}, at {} s.", format_short(moment.time_s));
    }
    let time = format!("{name}, at {} s", format_short(moment.time_s));
    let Some(ClosestPair { shapes: [a, b], distance_m, .. }) = moment.closest else {
        return format!("{time}.");
    };
    let [a, b] = [a, b].map(|shape| &moment.shapes[shape].name);
    let distance = format_short(1e3 * distance_m.abs());
    let verb = if distance_m < 0.0 { "penetrate each other by" } else { "are closest:" };
    format!("{time}: {a} and {b} {verb} {distance} mm.")
}

/// Cube of the world that all views show.
struct Part {
    center: Vector3<f64>,
    side_m: f64,
}

/// Box along the axes of the world.
#[derive(Clone, Copy)]
struct Bounds([Vector3<f64>; 2]);

impl Bounds {
    fn of(capsule: &Capsule) -> Self {
        let Capsule { start_m, end_m, radius_m } = capsule;
        let [low, high] = [start_m.inf(end_m), start_m.sup(end_m)];
        Self([low.add_scalar(-radius_m), high.add_scalar(*radius_m)])
    }

    fn union(self, other: Self) -> Self {
        Self([self.0[0].inf(&other.0[0]), self.0[1].sup(&other.0[1])])
    }

    /// Common part of two boxes, if there is any.
    fn intersection(self, other: Self) -> Option<Self> {
        let common = Self([self.0[0].sup(&other.0[0]), self.0[1].inf(&other.0[1])]);
        common.size().iter().all(|side| *side >= 0.0).then_some(common)
    }

    fn size(self) -> Vector3<f64> {
        self.0[1] - self.0[0]
    }

    fn center(self) -> Vector3<f64> {
        self.0[0].lerp(&self.0[1], 0.5)
    }
}

impl Part {
    /// Returns the cube around the arm at all moments, and what of the obstacles is near it.
    fn around(moments: &[CollisionMoment]) -> Self {
        let shapes = || moments.iter().flat_map(|moment| &moment.shapes);
        let links = shapes().filter(|shape| !shape.is_obstacle).filter_map(|shape| match &shape.shape {
            CollisionShape::Capsule(capsule) => Some(Bounds::of(capsule)),
            CollisionShape::HalfSpace(_) => None,
        });
        let arm =
            links.reduce(Bounds::union).unwrap_or(Bounds([-Vector3::repeat(1.0), Vector3::repeat(1.0)]));
        let reach = NEAR * arm.size().amax();
        let near = Bounds([arm.0[0].add_scalar(-reach), arm.0[1].add_scalar(reach)]);
        let obstacles = shapes().filter(|shape| shape.is_obstacle).filter_map(|shape| {
            near.intersection(match &shape.shape {
                CollisionShape::Capsule(capsule) => Bounds::of(capsule),
                CollisionShape::HalfSpace(HalfSpace { normal, offset_m }) => {
                    let above_m = normal.dot(&arm.center()) - offset_m;
                    Bounds([arm.center() - normal * above_m; 2])
                }
            })
        });
        let objects = moments
            .iter()
            .flat_map(|moment| &moment.environment)
            .filter_map(|object| near.intersection(Bounds(object.shape.nearest_box(&arm.center()))));
        let whole = obstacles.chain(objects).fold(arm, Bounds::union);
        Self { center: whole.center(), side_m: (1.0 + 2.0 * PADDING) * whole.size().amax().max(1e-3) }
    }

    fn bounds(&self) -> Bounds {
        let half = 0.5 * self.side_m;
        Bounds([self.center.add_scalar(-half), self.center.add_scalar(half)])
    }

    /// Corners of what a view shows, counter-clockwise.
    fn corners(&self, axes: [usize; 2]) -> [Vector2<f64>; 4] {
        let [low, high] = self.bounds().0.map(|corner| on(axes, &corner));
        [low, Vector2::new(high.x, low.y), high, Vector2::new(low.x, high.y)]
    }
}

impl View {
    /// Outline of a shape within the view, m: a convex polygon, without corners if the shape is not drawn.
    fn outline(&self, shape: &CollisionShape, part: &Part) -> Vec<Vector2<f64>> {
        let frame = part.corners(self.axes);
        match shape {
            CollisionShape::HalfSpace(HalfSpace { normal, offset_m }) => {
                let is_edge_on = normal[self.depth.0].abs() < EDGE_ON;
                if is_edge_on { cut(&frame, &on(self.axes, normal), *offset_m) } else { Vec::new() }
            }
            // A projection alone does not show that an obstacle is far away.
            CollisionShape::Capsule(capsule) if Bounds::of(capsule).intersection(part.bounds()).is_none() => {
                Vec::new()
            }
            CollisionShape::Capsule(Capsule { start_m, end_m, radius_m }) => {
                // The projection of a capsule: half a circle around each end of the projected axis.
                let [start, end] = [start_m, end_m].map(|point| on(self.axes, point));
                let along = (end - start).y.atan2((end - start).x);
                let half = |center: Vector2<f64>, from: f64| {
                    (0..=CORNERS).map(move |i| {
                        let (sine, cosine) = (from + PI * i as f64 / CORNERS as f64).sin_cos();
                        center + Vector2::new(cosine, sine) * *radius_m
                    })
                };
                let whole: Vec<Vector2<f64>> =
                    half(end, along - FRAC_PI_2).chain(half(start, along + FRAC_PI_2)).collect();
                within(whole, &frame)
            }
        }
    }

    /// Outline of an object of the environment within the view, m, as [`outline`](Self::outline).
    fn outline_of_object(&self, object: &PlacedObject, part: &Part) -> Vec<Vector2<f64>> {
        // A projection alone does not show that an object is far away.
        if Bounds(object.shape.nearest_box(&part.center)).intersection(part.bounds()).is_none() {
            return Vec::new();
        }
        object.shape.outline(self.axes, self.depth.0, &part.corners(self.axes))
    }

    /// Place of a shape on the line of sight; shapes with larger ones are in front.
    fn nearness(&self, shape: &CollisionShape) -> f64 {
        let (axis, side) = self.depth;
        match shape {
            CollisionShape::Capsule(capsule) => 0.5 * side * (capsule.start_m[axis] + capsule.end_m[axis]),
            CollisionShape::HalfSpace(_) => f64::NEG_INFINITY,
        }
    }

    /// Draws the view of a moment as one `<svg>` element.
    fn svg(&self, moment: &CollisionMoment, part: &Part) -> String {
        let title = format!("{}: {}", moment.name, self.name);
        canvas(&title, &sentence(moment), (SIDE + BESIDE, SIDE + ABOVE_AND_BELOW), |root| {
            let [x, y] = self.axes.map(|axis| {
                let half = 0.5 * part.side_m;
                Axis::linear(part.center[axis] - half..part.center[axis] + half, 0.0, AXES[axis], 5)
            });
            let place = |point: &Vector2<f64>| (x.place(point.x), y.place(point.y));
            let mut chart = chart(root, self.name, LEFT, &x, &y)?;
            self.draw_environment(&mut chart, moment, part, place)?;
            let mut order: Vec<usize> = (0..moment.shapes.len()).collect();
            order.sort_by(|a, b| {
                let [a, b] = [*a, *b].map(|shape| self.nearness(&moment.shapes[shape].shape));
                a.total_cmp(&b)
            });
            for shape in order {
                let PlacedShape { name, is_obstacle, shape: placed, .. } = &moment.shapes[shape];
                let outline: Vec<(f64, f64)> = self.outline(placed, part).iter().map(place).collect();
                let role = Role::of(moment, shape);
                // The names of the closest pair are above the views, and its line would cross them.
                let label = (*is_obstacle && role != Role::Closest).then_some(name.as_str());
                draw(&mut chart, outline, role, label)?;
            }
            self.draw_closest(&mut chart, moment, place)
        })
    }

    /// Draws the objects of the environment, behind all else.
    fn draw_environment(
        &self,
        chart: &mut Chart<'_>,
        moment: &CollisionMoment,
        part: &Part,
        place: impl Fn(&Vector2<f64>) -> (f64, f64),
    ) -> Drawn {
        let mut named = None;
        for object in &moment.environment {
            let outline: Vec<(f64, f64)> = self.outline_of_object(object, part).iter().map(&place).collect();
            if outline.len() < 3 {
                continue;
            }
            // A hole in a plane that is seen has the name of the plane.
            let label = (named != Some(&object.name)).then_some(object.name.as_str());
            named = Some(&object.name);
            draw(chart, outline, Role::Environment, label)?;
        }
        Ok(())
    }

    /// Draws the line between the closest points, if a pair is kept apart.
    fn draw_closest(
        &self,
        chart: &mut Chart<'_>,
        moment: &CollisionMoment,
        place: impl Fn(&Vector2<f64>) -> (f64, f64),
    ) -> Drawn {
        let Some(closest) = &moment.closest else { return Ok(()) };
        let [a, b] = closest.points_m.map(|point| place(&on(self.axes, &point)));
        chart.draw_series([PathElement::new(vec![a, b], INK.stroke_width(8))])?;
        chart.draw_series([a, b].map(|at| Circle::new(at, px(3), INK.filled())))?;
        Ok(())
    }
}

/// Draws an outline and its label; nothing if it has no corners.
fn draw(chart: &mut Chart<'_>, mut outline: Vec<(f64, f64)>, role: Role, label: Option<&str>) -> Drawn {
    if outline.len() < 3 {
        return Ok(());
    }
    let middle = outline.iter().fold((0.0, 0.0), |sum, point| (sum.0 + point.0, sum.1 + point.1));
    let middle = (middle.0 / outline.len() as f64, middle.1 / outline.len() as f64);
    let color = role.color();
    chart.draw_series([Polygon::new(outline.clone(), color.mix(OPACITY).filled())])?;
    outline.push(outline[0]);
    chart.draw_series([PathElement::new(outline, color.stroke_width(6))])?;
    if let Some(name) = label {
        let style = text(11, FontStyle::Italic).pos(Pos::new(HPos::Center, VPos::Center));
        chart.draw_series([Text::new(printable(name), middle, style)])?;
    }
    Ok(())
}
