//! Convex polygons in a view.

use nalgebra::{Vector2, Vector3};

/// Projection of a vector on two axes.
pub(crate) fn on(axes: [usize; 2], point: &Vector3<f64>) -> Vector2<f64> {
    Vector2::new(point[axes[0]], point[axes[1]])
}

/// Part of a convex polygon in which normal ∙ x ≤ offset (Sutherland and Hodgman, 1974).
pub(crate) fn cut(polygon: &[Vector2<f64>], normal: &Vector2<f64>, offset: f64) -> Vec<Vector2<f64>> {
    let mut kept = Vec::new();
    for (i, corner) in polygon.iter().enumerate() {
        let next = &polygon[(i + 1) % polygon.len()];
        let [beyond, next_beyond] = [corner, next].map(|point| normal.dot(point) - offset);
        if beyond <= 0.0 {
            kept.push(*corner);
        }
        if (beyond <= 0.0) != (next_beyond <= 0.0) {
            kept.push(corner.lerp(next, beyond / (beyond - next_beyond)));
        }
    }
    kept
}

/// Part of a convex polygon within another one, whose corners are counter-clockwise.
pub(crate) fn within(polygon: Vec<Vector2<f64>>, frame: &[Vector2<f64>; 4]) -> Vec<Vector2<f64>> {
    (0..frame.len()).fold(polygon, |polygon, i| {
        let along = frame[(i + 1) % frame.len()] - frame[i];
        let outward = Vector2::new(along.y, -along.x);
        cut(&polygon, &outward, outward.dot(&frame[i]))
    })
}

/// Corners of the convex hull of points, counter-clockwise (Andrew's monotone chain, 1979).
pub(crate) fn hull(mut points: Vec<Vector2<f64>>) -> Vec<Vector2<f64>> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let half = |points: &mut dyn Iterator<Item = &Vector2<f64>>| {
        let mut chain: Vec<Vector2<f64>> = Vec::new();
        for point in points {
            while let [.., a, b] = chain[..] {
                if (b - a).perp(&(point - b)) > 0.0 {
                    break;
                }
                chain.pop();
            }
            chain.push(*point);
        }
        // The last corner is the first of the other half.
        chain.pop();
        chain
    };
    let mut corners = half(&mut points.iter());
    corners.extend(half(&mut points.iter().rev()));
    corners
}
