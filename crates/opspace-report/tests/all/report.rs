//! Figures, tables and pages: they are well-formed XML, contain the input, and draw it at the right place.

use opspace_experiment::evaluate::spread::Spread;
use opspace_experiment::evaluate::table::{Cell, Table};
use opspace_experiment::text::format_number;
use opspace_report::figure::{Comparison, ComparisonRow, Figure, Panel, Scale, Series, Style, decimate};
use opspace_report::html::Page;
use opspace_testing::browser::Browser;
use roxmltree::{Document, Node, ParsingOptions};

const SVG: &str = "http://www.w3.org/2000/svg";
pub const NASTY: &str = "a <b> & \"c\" 'd' \u{1} </svg><script>alert(1)</script>";

pub fn xml(text: &str) -> Document<'_> {
    let options = ParsingOptions { allow_dtd: true, ..ParsingOptions::default() };
    Document::parse_with_options(text, options).unwrap_or_else(|error| panic!("{error}\n{text}"))
}

pub fn texts(document: &Document<'_>) -> Vec<String> {
    document
        .descendants()
        .filter(|node| node.has_tag_name("text") || node.tag_name().name() == "text")
        .filter_map(|node| node.text().map(|text| text.trim().to_owned()))
        .collect()
}

/// Lines of the series without the lines of the legend (`labels`); axes and marks have lower opacity.
fn lines<'a, 'i>(document: &'a Document<'i>, labels: usize) -> Vec<Node<'a, 'i>> {
    let line = |node: &Node<'_, '_>| {
        node.tag_name().name() == "polyline"
            && node.attribute("opacity").is_some_and(|opacity| opacity == "1")
    };
    document.descendants().filter(line).skip(labels).collect()
}

/// Points of a line, in canvas units.
pub fn points(line: &Node<'_, '_>) -> Vec<(f64, f64)> {
    let point = |part: &str| {
        let (x, y) = part.split_once(',').expect("x and y");
        (x.parse().expect("a number"), y.parse().expect("a number"))
    };
    line.attribute("points").expect("a line").split_whitespace().map(point).collect()
}

fn panel(title: &str, series: Vec<Series>) -> Panel {
    Panel {
        title: title.to_owned(),
        x_label: "time (s)".to_owned(),
        y_label: "torque (N·m)".to_owned(),
        series,
        ..Panel::default()
    }
}

fn figure(panels: Vec<Panel>) -> Figure {
    Figure {
        title: "Torques".to_owned(),
        caption: "Desired and measured.".to_owned(),
        panels,
        ..Figure::default()
    }
}

fn wave(amplitude: f64, phase: f64, samples: usize) -> (Vec<f64>, Vec<f64>) {
    let x: Vec<f64> = (0..samples).map(|k| k as f64 * 8.0 / samples as f64).collect();
    let y = x
        .iter()
        .map(|t| amplitude * ((2.1 * t + phase).sin() + 0.4 * (5.3 * t + 2.0 * phase).sin()))
        .collect();
    (x, y)
}

/// Figure of four joints, like figure 8 of the paper.
fn joints(samples: usize) -> Figure {
    let joint = |(index, name): (usize, &str)| {
        let (x, desired) = wave(3.0 + index as f64, index as f64, samples);
        let jitter = |k: usize| 0.35 * ((k * 2_654_435_761 % 1000) as f64 / 1000.0 - 0.5);
        let measured = desired.iter().enumerate().map(|(k, y)| 0.97 * y + jitter(k)).collect();
        let mut panel = panel(
            name,
            vec![
                Series::new("desired", x.clone(), desired).style(Style::Desired),
                Series::new("measured", x, measured),
            ],
        );
        panel.marks.push((1.5, "settled".to_owned()));
        panel
    };
    figure(
        ["shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow"]
            .into_iter()
            .enumerate()
            .map(joint)
            .collect(),
    )
}

#[test]
fn four_joints_make_four_panels_with_one_legend() {
    let svg = joints(40_000).svg();
    let document = xml(&svg);
    let root = document.root_element();
    assert_eq!((root.tag_name().name(), root.attribute("role")), ("svg", Some("img")));
    assert_eq!(root.first_element_child().and_then(|title| title.text()), Some("Torques"));
    let texts = texts(&document);
    let count = |wanted: &str| texts.iter().filter(|text| *text == wanted).count();
    assert_eq!((count("measured"), count("desired"), count("elbow")), (1, 1, 1));
    assert_eq!((count("torque (N·m)"), count("time (s)")), (4, 4));
    // In each panel, the desired line is thinner than the measured line, has another colour, and is drawn on top of
    // it.
    let look = |line: &Node<'_, '_>| {
        let width: u32 = line.attribute("stroke-width").expect("a width").parse().expect("a number");
        (width, line.attribute("stroke").expect("a colour").to_owned())
    };
    let looks: Vec<(u32, String)> = lines(&document, 2).iter().map(look).collect();
    assert_eq!(looks.len(), 8);
    for pair in looks.chunks(2) {
        assert!(pair == &looks[..2] && pair[0].0 > pair[1].0 && pair[0].1 != pair[1].1, "{looks:?}");
    }
    assert!(svg.len() < 300_000, "{} bytes", svg.len());
}

/// Points of a measured response: one dot for each point with logarithms, and decades of equal width.
#[test]
fn decades_have_equal_width_and_points_are_dots() {
    const TOLERANCE: f64 = 1.0;
    let x = vec![1.0, 10.0, 100.0, 1000.0, 0.0];
    let y = vec![1.0, 0.1, 0.01, 0.001, 5.0];
    let panel = Panel {
        x_scale: Scale::Log,
        y_scale: Scale::Log,
        ..panel("magnitude", vec![Series::new("measured", x, y).style(Style::Dots)])
    };
    let svg = figure(vec![panel]).svg();
    let document = xml(&svg);
    let number = |node: &Node<'_, '_>, name: &str| -> f64 {
        node.attribute(name).expect(name).parse().expect("a number")
    };
    let dots: Vec<(f64, f64)> = (document.descendants().filter(|node| node.has_tag_name("circle")))
        .map(|dot| (number(&dot, "cx"), number(&dot, "cy")))
        .collect();
    let points = &dots;
    assert_eq!(points.len(), 4, "{dots:?}");
    let steps: Vec<(f64, f64)> = points.windows(2).map(|p| (p[1].0 - p[0].0, p[1].1 - p[0].1)).collect();
    for (right, down) in &steps {
        assert!((right - steps[0].0).abs() <= TOLERANCE && *right > 0.0, "{steps:?}");
        assert!((down - steps[0].1).abs() <= TOLERANCE && *down > 0.0, "{steps:?}");
    }
}

/// All points are drawn within the picture, and panels do not overlap.
#[test]
fn points_stay_within_the_figure() {
    let svg = joints(2_000).svg();
    let document = xml(&svg);
    let size: Vec<f64> = document
        .root_element()
        .attribute("viewBox")
        .expect("a size")
        .split(' ')
        .map(|number| number.parse().expect("a number"))
        .collect();
    let extent = |line: &Node<'_, '_>| {
        points(line).iter().fold((f64::MAX, f64::MIN, f64::MAX, f64::MIN), |(l, r, t, b), &(x, y)| {
            (l.min(x), r.max(x), t.min(y), b.max(y))
        })
    };
    let extents: Vec<_> = lines(&document, 2).iter().map(extent).collect();
    for &(left, right, top, bottom) in &extents {
        assert!(left >= 0.0 && right <= size[2] && top >= 0.0 && bottom <= size[3]);
    }
    assert!(extents[0].1 < extents[2].0, "the second column is right of the first");
    assert!(extents[0].3 < extents[4].2, "the second row is below the first");
}

/// Compared: the extremes of the reduced line, and those of all samples: they are bit-identical, independent of the
/// phase of a peak.
#[test]
fn decimation_keeps_every_extreme_and_gap() {
    let (x, mut y) = wave(1.0, 0.3, 100_000);
    y[12_345] = 50.0;
    y[77_777] = -60.0;
    let kept = decimate(&x, &y, (0.0, 8.0), 400);
    assert_eq!(kept.len(), 1);
    assert!(kept[0].len() <= 4 * 401, "{} points", kept[0].len());
    for (low, high) in [(0.0, 1.0), (1.0, 6.5), (6.5, 8.0)] {
        // The limits are column borders, so that both contain the same samples.
        let extremes = |points: &mut dyn Iterator<Item = (f64, f64)>| {
            points
                .filter(|&(x, _)| x >= low && x < high)
                .fold((f64::MAX, f64::MIN), |(l, h), (_, y)| (l.min(y), h.max(y)))
        };
        let all = extremes(&mut x.iter().copied().zip(y.iter().copied()));
        assert_eq!(extremes(&mut kept[0].iter().copied()), all);
    }
    assert!(kept[0].windows(2).all(|pair| pair[0].0 <= pair[1].0), "samples stay in order");
    assert_eq!((kept[0][0], kept[0][kept[0].len() - 1]), ((x[0], y[0]), (x[99_999], y[99_999])));

    for gap in [f64::NAN, f64::INFINITY] {
        let y = [1.0, 2.0, gap, gap, 3.0, gap, 4.0, 5.0];
        let x: Vec<f64> = (0..8).map(f64::from).collect();
        let stretches = decimate(&x, &y, (0.0, 8.0), 100);
        let wanted = vec![vec![(0.0, 1.0), (1.0, 2.0)], vec![(4.0, 3.0)], vec![(6.0, 4.0), (7.0, 5.0)]];
        assert_eq!(stretches, wanted);
    }
    assert!(decimate(&[], &[], (0.0, 1.0), 10).is_empty());
    // A slow sensor in a fast log has a gap between any two samples: there must not be more sections than columns.
    let sparse: Vec<f64> =
        y.iter().enumerate().map(|(k, y)| if k % 10 == 0 { *y } else { f64::NAN }).collect();
    assert!(decimate(&x, &sparse, (0.0, 8.0), 400).len() <= 400);
}

/// Compared: the height of a line in the picture, and the fraction of the axis that corresponds to the value.
#[test]
fn line_is_drawn_to_scale() {
    let series = Series::new("a", vec![0.0, 1.0, 2.0, 4.0], vec![0.0, 10.0, 5.0, 10.0]);
    let svg = figure(vec![panel("p", vec![series])]).svg();
    let document = xml(&svg);
    let drawn = points(&lines(&document, 0)[0]);
    let rise = |k: usize| drawn[0].1 - drawn[k].1;
    let run = |k: usize| drawn[k].0 - drawn[0].0;
    // Coordinates are integers on a canvas with four times the resolution of the page.
    let rounding = 1.5;
    assert!(rise(1) > 400.0 && (rise(2) - rise(1) / 2.0).abs() < rounding, "{drawn:?}");
    assert!(
        run(3) > 2000.0
            && (run(1) - run(3) / 4.0).abs() < rounding
            && (run(2) - run(3) / 2.0).abs() < rounding
    );
}

/// Compared: a single sample among many, and its place in the picture; peaks and gaps are preserved by the reduction.
#[test]
fn peaks_and_gaps_are_drawn() {
    let x: Vec<f64> = (0..40_000).map(|k| f64::from(k) * 2e-4).collect();
    let mut y = vec![0.0; 40_000];
    (y[12_345], y[23_456]) = (50.0, -25.0);
    y[30_000..31_000].fill(f64::NAN);
    let svg = figure(vec![panel("p", vec![Series::new("a", x.clone(), y)])]).svg();
    let document = xml(&svg);
    let drawn: Vec<Vec<(f64, f64)>> = lines(&document, 0).iter().map(points).collect();
    assert_eq!(drawn.len(), 2, "a line before the gap, and one after it");
    let zero = drawn[1][0].1;
    let by_height = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
    let (highest, lowest) = (
        drawn[0].iter().min_by(by_height).expect("points"),
        drawn[0].iter().max_by(by_height).expect("points"),
    );
    // Coordinates are integers on a canvas with four times the resolution of the page.
    let rounding = 1.5;
    assert!(
        zero - highest.1 > 200.0 && ((zero - highest.1) - 2.0 * (lowest.1 - zero)).abs() < 2.0 * rounding
    );
    let (first, last) = (drawn[0][0].0, drawn[1][drawn[1].len() - 1].0);
    let place = |k: usize| first + (last - first) * x[k] / x[39_999];
    assert!((highest.0 - place(12_345)).abs() < rounding && (lowest.0 - place(23_456)).abs() < rounding);
    assert!((drawn[0][drawn[0].len() - 1].0 - place(29_999)).abs() < rounding);
    assert!((drawn[1][0].0 - place(31_000)).abs() < rounding);
}

/// Values before the abscissa that determines the scale are cut off, and the title says so.
#[test]
fn values_before_the_scale_are_cut_off() {
    let x: Vec<f64> = (0..1000).map(|k| f64::from(k) * 1e-3).collect();
    let y = x.iter().map(|x| if *x < 0.2 { 36.0 } else { *x }).collect();
    let mut cut = panel("p", vec![Series::new("a", x, y)]);
    let full = points(&lines(&xml(&figure(vec![cut.clone()]).svg()), 0)[0]);
    cut.range_from_x = Some(0.2);
    let svg = figure(vec![cut]).svg();
    let document = xml(&svg);
    assert!(
        texts(&document).iter().any(|text| text == "p (cut off before 0.2 s: up to 36)"),
        "{:?}",
        texts(&document)
    );
    let drawn = points(&lines(&document, 0)[0]);
    assert!(drawn[0].0 > full[0].0, "the part before is not drawn");
    // A run that was stopped before is drawn as a whole.
    let x: Vec<f64> = (0..100).map(|k| f64::from(k) * 1e-3).collect();
    let early = Panel { range_from_x: Some(0.2), ..panel("p", vec![Series::new("a", x.clone(), x)]) };
    assert!(texts(&xml(&figure(vec![early]).svg())).iter().any(|text| text == "p"));
    let rise = |points: &[(f64, f64)]| {
        let heights = || points.iter().filter(|(x, _)| *x > drawn[0].0).map(|(_, y)| *y);
        heights().fold(f64::MIN, f64::max) - heights().fold(f64::MAX, f64::min)
    };
    assert!(rise(&drawn) > 20.0 * rise(&full), "the rest has the whole height");
}

/// Marks are drawn before the lines, so that these are visible; each label has a row of its own above them, and thin lines
/// are below solid ones.
#[test]
fn marks_are_behind_the_lines() {
    let wave = |label: &str, style| Series::new(label, vec![0.0, 1.0, 2.0], vec![0.0, 5.0, 0.0]).style(style);
    let mut panel = panel("p", vec![wave("solid", Style::Solid), wave("thin", Style::Thin)]);
    panel.marks = vec![(1.0, "one".to_owned()), (1.05, "two".to_owned()), (0.5, String::new())];
    let svg = figure(vec![panel]).svg();
    let document = xml(&svg);
    let all: Vec<Node<'_, '_>> =
        document.descendants().filter(|node| node.has_tag_name((SVG, "polyline"))).collect();
    let place = |opacity: &str| {
        all.iter().rposition(|node| node.attribute("opacity") == Some(opacity)).expect("a line")
    };
    let (marks, thin, solid) = (place("0.55"), place("0.9"), place("1"));
    assert!(marks < thin && thin < solid, "{marks} {thin} {solid}");
    let top = points(&all[solid]).iter().map(|(_, y)| *y).fold(f64::MAX, f64::min);
    let label = |name: &str| -> f64 {
        let mut texts = document.descendants().filter(|node| node.has_tag_name((SVG, "text")));
        let text = texts.find(|node| node.text().is_some_and(|text| text.trim() == name)).expect(name);
        text.attribute("y").expect("a place").parse().expect("a number")
    };
    assert!(label("one") < label("two") && label("two") < top, "{} {} {top}", label("one"), label("two"));
}

/// Decades have one notation, and the least value of a logarithmic axis is above its end.
#[test]
fn logarithmic_axis_has_one_notation() {
    let counts = |largest: f64| {
        let series = Series::new("a", vec![1.0, 2.0, 3.0], vec![1.0, 10.0, largest]);
        let panel = Panel { y_scale: Scale::Log, ..panel("p", vec![series]) };
        figure(vec![panel]).svg()
    };
    let said = texts(&xml(&counts(2e4)));
    assert!(said.contains(&"10⁰".to_owned()) && said.contains(&"10⁵".to_owned()), "{said:?}");
    assert!(!said.contains(&"10000".to_owned()), "{said:?}");
    let svg = counts(1000.0);
    let document = xml(&svg);
    let said = texts(&document);
    assert!(said.contains(&"1000".to_owned()) && !said.contains(&"10⁰".to_owned()), "{said:?}");
    let lowest = points(&lines(&document, 0)[0])[0].1;
    let axis = document.descendants().filter(|node| node.has_tag_name((SVG, "polyline")));
    let bottom = axis.flat_map(|line| points(&line)).map(|(_, y)| y).fold(f64::MIN, f64::max);
    assert!(bottom - lowest > 20.0, "{lowest} above {bottom}");
}

#[test]
fn figures_without_data_say_so() {
    let said = |panels: Vec<Panel>| texts(&xml(&figure(panels).svg()));
    let has = |texts: &[String], wanted: &str| {
        assert!(texts.iter().any(|text| text.contains(wanted)), "{wanted:?} is not among {texts:?}");
    };
    let x = vec![0.0, 1.0, 2.0];
    has(&said(vec![]), "no data");
    has(&said(vec![panel("p", vec![])]), "no data");
    has(&said(vec![panel("p", vec![Series::new("a", vec![], vec![])])]), "no data");
    has(&said(vec![panel("p", vec![Series::new("a", x.clone(), vec![f64::NAN; 3])])]), "no finite value");
    has(&said(vec![panel("p", vec![Series::new("a", x.clone(), vec![3.0; 3])])]), "constant");
    has(&said(vec![panel("p", vec![Series::new("a", x.clone(), vec![0.0; 3])])]), "constant");
    let partly =
        vec![Series::new("a", x.clone(), vec![1.0, 2.0, 3.0]), Series::new("b", x, vec![f64::NAN; 3])];
    has(&said(vec![panel("p", partly)]), "b: no finite value");
}

/// Arbitrary numbers: the result is XML, and all coordinates are numbers.
#[test]
fn arbitrary_numbers_make_valid_figures() {
    let tiny = f64::MIN_POSITIVE;
    let columns = [
        vec![f64::MAX, f64::MIN, 0.0],
        vec![1e-320, 2e-320, 0.0],
        vec![tiny, -tiny, tiny],
        vec![1e9, 1e9 + 1.0, 1e9 + 2.0],
        vec![1.0, 1.0 + f64::EPSILON, 1.0],
        vec![f64::INFINITY, 1.0, f64::NEG_INFINITY],
        vec![1e-7, -3e-7, 2e-7],
        vec![-5.0],
        vec![-0.0, 0.0, -0.0],
    ];
    for x in &columns {
        for y in &columns {
            let svg = figure(vec![panel("p", vec![Series::new("a", x.clone(), y.clone())])]).svg();
            xml(&svg);
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{x:?} {y:?}\n{svg}");
        }
    }
    let small = figure(vec![panel("p", vec![Series::new("a", vec![0.0, 1.0], vec![1e-7, 3e-7])])]).svg();
    assert!(small.contains("torque (N·m) × 10⁻⁹"), "{small}");
}

fn comparison() -> Comparison {
    let row = |label: &str, values: &[Option<f64>]| ComparisonRow {
        label: label.to_owned(),
        values: values.iter().map(|value| Spread::of(*value)).collect(),
    };
    Comparison {
        title: "Position error".to_owned(),
        caption: "Root mean square over the motion axes; left is better.".to_owned(),
        x_label: "position error (m)".to_owned(),
        series: ["torque", "position, transformer", "position, inverse kinematics"]
            .map(str::to_owned)
            .to_vec(),
        rows: vec![
            row("cartesian-reach", &[Some(0.0011), Some(0.0019), Some(0.0007)]),
            row("compliant-x", &[Some(0.002), Some(0.0043), None]),
            row("circle-fast", &[Some(0.0052), Some(0.011), Some(0.034)]),
        ],
        scale: Scale::Log,
    }
}

#[test]
fn comparison_places_larger_values_further_right() {
    for scale in [Scale::Log, Scale::Linear] {
        let svg = Comparison { scale, ..comparison() }.svg();
        let document = xml(&svg);
        // Of the three marker shapes, discs are filled.
        let disc = |node: &Node<'_, '_>| {
            node.has_tag_name((SVG, "circle")) && node.attribute("fill") != Some("none")
        };
        let mut discs: Vec<f64> = document
            .descendants()
            .filter(disc)
            .map(|node| node.attribute("cx").expect("a place").parse().expect("a number"))
            .collect();
        assert_eq!(discs.len(), 4, "the legend's and one a row");
        discs.remove(0);
        assert!(discs[0] < discs[1] && discs[1] < discs[2], "{discs:?}");
        assert!(texts(&document).iter().any(|text| text == "circle-fast"));
    }
}

/// Compared: the lines of two spreads, and their ends on the scale: a line from the lowest to the highest value passes
/// through the mark of the median.
#[test]
fn comparison_draws_intervals() {
    let with = |values: [f64; 3]| {
        let row = ComparisonRow { label: "r".to_owned(), values: vec![Spread::of(values)] };
        let svg = Comparison {
            rows: vec![row],
            series: vec!["one".to_owned()],
            scale: Scale::Linear,
            ..comparison()
        }
        .svg();
        let document = xml(&svg);
        let wide = |node: &Node<'_, '_>| node.attribute("stroke-width") == Some("6");
        let line = document
            .descendants()
            .find(wide)
            .expect("a line")
            .attribute("points")
            .expect("points")
            .to_owned();
        let ends: Vec<f64> = line
            .split_whitespace()
            .map(|point| point.split(',').next().expect("x").parse().expect("a number"))
            .collect();
        (ends[0], ends[1])
    };
    let (low, high) = with([1.0, 2.0, 4.0]);
    assert!(low < high);
    let (narrow_low, narrow_high) = with([3.0, 2.0, 4.0]);
    assert!(narrow_high - narrow_low < 0.8 * (high - low));
}

#[test]
fn incomplete_comparisons_name_missing_values() {
    xml(&Comparison::default().svg());
    let with = |scale, values: Vec<Option<f64>>| {
        let row =
            ComparisonRow { label: "r".to_owned(), values: values.into_iter().map(Spread::of).collect() };
        Comparison { rows: vec![row], scale, ..comparison() }.svg()
    };
    assert!(with(Scale::Linear, vec![None, None, None]).contains("no data"));
    assert!(with(Scale::Log, vec![Some(0.0), Some(-1.0), Some(f64::NAN)]).contains("no data"));
    assert!(with(Scale::Log, vec![Some(0.0), Some(2.0)]).contains("1 not shown"));
    for value in [f64::MAX, f64::MIN_POSITIVE, 0.0, -3.0, 1e-320] {
        for scale in [Scale::Linear, Scale::Log] {
            let svg = with(scale, vec![Some(value)]);
            xml(&svg);
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        }
    }
}

#[test]
fn numbers_have_four_digits() {
    let cases = [
        (0.0, "0"),
        (-0.0, "0"),
        (12.34567, "12.35"),
        (0.012341, "0.01234"),
        (0.99999, "1.000"),
        (123_456.0, "123456"),
        (1.5e9, "1.500e9"),
        (-2.5e-7, "-2.500e-7"),
        (f64::NAN, "not a number"),
        (f64::INFINITY, "inf"),
    ];
    for (number, text) in cases {
        assert_eq!(format_number(number), text);
    }
}

/// Compared: the texts of a column, and decimals counted manually.
#[test]
fn column_shares_its_decimals() {
    let column = |numbers: &[f64]| {
        let mut table = Table::new(&[("a", "m")]);
        numbers.iter().for_each(|&number| table.push(vec![number.into()]));
        table.texts().concat()
    };
    assert_eq!(column(&[0.0431, 0.000_71, 0.0]), ["0.04310", "0.00071", "0.00000"]);
    assert_eq!(column(&[0.431, 0.000_71]), ["0.43100", "0.00071"]);
    assert_eq!(column(&[12.3456, f64::NAN]), ["12.35", "not a number"]);
    assert_eq!(column(&[1e9, 1.0]), ["1.000e9", "1.000"]);
    assert_eq!(column(&[0.0, -0.0]), ["0", "0"]);
    let mut by_row = Table::new(&[("rms", ""), ("max", "")]);
    by_row.decimals_by_row = true;
    by_row.push(vec![8.651.into(), 13.249.into()]);
    by_row.push(vec![Cell::Empty, 15.4.into()]);
    assert_eq!(by_row.texts(), [["8.65", "13.25"], ["–", "15.40"]]);
}

fn sample_table() -> Table {
    let mut table = Table::new(&[
        ("Task", ""),
        ("Backend", ""),
        ("Controller", ""),
        ("Position RMS", "m"),
        ("Position max", "m"),
        ("Torque error", "%"),
        ("Bar", ""),
    ]);
    let row = |task: &str, backend: &str, controller: &str, values: [Option<f64>; 3], bar: Cell| {
        let mut row: Vec<Cell> = vec![task.into(), backend.into(), controller.into()];
        row.extend(values.map(Cell::from));
        row.push(bar);
        row
    };
    let pass = || Cell::Pass("met".to_owned());
    table.push(row("cartesian-reach", "torque", "osc", [Some(0.0011), Some(0.0042), Some(0.0)], pass()));
    table.push(row("cartesian-reach", "position", "osc", [Some(0.001_93), Some(0.0061), Some(4.31)], pass()));
    table.push(row("cartesian-reach", "position", "ik", [Some(0.000_71), Some(0.0031), None], pass()));
    table.push(row("compliant-x", "torque", "osc", [Some(0.0021), Some(0.0077), Some(0.0)], pass()));
    let fail = Cell::Fail("faulted at 3.1 s: joint limit".to_owned());
    table.push(row("compliant-x", "position", "ik", [Some(0.0431), Some(0.0912), None], fail));
    table
}

fn sample_page(samples: usize) -> Page {
    let axis = |(index, name): (usize, &str)| {
        let (x, reference) = wave(0.02, index as f64, samples);
        let hand: Vec<f64> =
            reference.iter().enumerate().map(|(k, y)| y + 0.001 * (0.01 * k as f64).sin()).collect();
        let force = vec![
            Series::new("reference", x.clone(), reference).style(Style::Desired),
            Series::new("hand", x, hand),
        ];
        Panel { y_label: "position (m)".to_owned(), ..panel(name, force) }
    };
    let hand = Figure {
        title: "The hand in world axes".to_owned(),
        caption: "x yields to the operator; y and z hold their place.".to_owned(),
        panels: ["x", "y", "z"].into_iter().enumerate().map(axis).collect(),
        ..Figure::default()
    };
    let empty = figure(vec![
        panel("no sensor", vec![Series::new("measured", vec![], vec![])]),
        panel("broken", vec![Series::new("measured", vec![0.0, 1.0], vec![f64::NAN; 2])]),
        panel("still", vec![Series::new("measured", vec![0.0, 1.0, 2.0], vec![2.5; 3])]),
        panel("small", vec![Series::new("measured", vec![0.0, 1.0, 2.0], vec![1e-7, f64::NAN, 3e-7])]),
    ]);
    Page::new("compliant-x on asimo-arm")
        .lead(
            "The hand is compliant in x with 3.1 N RMS at the operator's hand, and holds y and z to 4.3 mm.",
        )
        .warning("The run faulted at 3.1 s: joint `elbow` reached its limit.")
        .table(
            "Every task on every backend.",
            &sample_table(),
            &["Statistics run from settle_s to the end.", "– : not defined."],
        )
        .section("Torques")
        .paragraph("The transformer turns each desired torque into a joint set point.")
        .figure(&joints(samples))
        .section("Motion")
        .figure(&hand)
        .comparison(&comparison())
        .section("Without data")
        .figure(&empty)
        .section("This run")
        .facts([
            ("Seed", "1"),
            ("opspace", "0.1.0"),
            ("Task", "tasks/compliant-x.toml"),
            ("SHA-256", "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"),
        ])
}

#[test]
fn note_is_not_called_a_warning() {
    let html = Page::new("a run").warning("Note: 5 mm away.").warning("The log is damaged.").render();
    let kinds = ["<strong>Note.</strong> 5 mm away.", "<strong>Warning.</strong> The log is damaged."];
    assert!(kinds.iter().all(|kind| html.contains(kind)), "{html}");
}

#[test]
fn page_is_self_contained() {
    let html = sample_page(40_000).render();
    let document = xml(&html);
    assert!(html.len() < 2_000_000, "{} bytes", html.len());
    for node in document.descendants().filter(Node::is_element) {
        let name = node.tag_name().name();
        assert!(!["link", "img", "iframe"].contains(&name), "<{name}>");
        for attribute in node.attributes() {
            assert!(!["src", "href"].contains(&attribute.name()), "{name} {}", attribute.name());
        }
    }
    assert!(!html.contains("@import") && !html.contains("url("));
    // One script, which the policy permits by its hash.
    let scripts: Vec<Node<'_, '_>> =
        document.descendants().filter(|node| node.has_tag_name("script")).collect();
    let [script] = &scripts[..] else { panic!("{} scripts", scripts.len()) };
    assert!(!script.text().unwrap_or_default().contains("fetch("));
    assert!(html.contains("default-src 'none'") && html.contains("script-src 'sha256-"), "the policy");
    // Every colour of the figures has a replacement in the dark scheme.
    for node in document.descendants().filter(|node| node.tag_name().namespace() == Some(SVG)) {
        for name in ["stroke", "fill"] {
            if let Some(color) = node.attribute(name).filter(|color| *color != "none") {
                assert!(html.contains(&format!("svg [{name}='{color}'] {{")), "{name} {color}");
            }
        }
    }
    let named =
        |tag: &str| document.descendants().filter(|node| node.tag_name().name() == tag).collect::<Vec<_>>();
    assert_eq!((named("figure").len(), named("caption").len(), named("h1").len()), (4, 1, 1));
    assert!(named("th").iter().all(|head| head.has_attribute("scope")));
    assert!(named("svg").iter().all(|svg| svg.attribute("role") == Some("img")));
}

/// Text with markup at every place where a page accepts text: it is read back as text and adds no elements.
#[test]
fn all_text_is_escaped() {
    let page = |text: &str| {
        let mut table = Table::new(&[(text, text)]);
        table.push(vec![text.into()]);
        table.push(vec![Cell::Fail(text.to_owned())]);
        let mut panel = panel(text, vec![Series::new(text, vec![0.0, 1.0], vec![0.0, 1.0])]);
        (panel.x_label, panel.y_label) = (text.to_owned(), text.to_owned());
        panel.marks.push((0.5, text.to_owned()));
        let figure = Figure { title: text.to_owned(), caption: text.to_owned(), ..figure(vec![panel]) };
        let row = ComparisonRow { label: text.to_owned(), values: vec![Spread::of([1.0])] };
        let comparison = Comparison { rows: vec![row], series: vec![text.to_owned()], ..comparison() };
        let page =
            Page::new(text).lead(text).section(text).paragraph(text).warning(text).facts([(text, text)]);
        page.table(text, &table, &[text]).figure(&figure).comparison(&comparison).render()
    };
    let (plain, nasty) = (page("plain"), page(NASTY));
    let elements = |html: &str| xml(html).descendants().filter(Node::is_element).count();
    assert_eq!(elements(&plain), elements(&nasty));
    let whole = |html: &str| {
        xml(html).descendants().filter_map(|node| node.text().map(str::to_owned)).collect::<String>()
    };
    let shown = NASTY.replace('\u{1}', "\u{fffd}");
    assert_eq!(whole(&plain).matches("plain").count(), whole(&nasty).matches(&shown).count());
}

#[test]
fn ragged_and_empty_tables_are_valid() {
    let mut table = Table::new(&[("a", ""), ("b", "m")]);
    let empty = Page::new("t").table("c", &table, &[]).render();
    assert!(empty.contains("no rows"));
    table.push(vec![]);
    table.push(vec![1.0.into(), Cell::Empty, "too many".into()]);
    let html = Page::new("t").table("c", &table, &[]).render();
    let document = xml(&html);
    let cells = |row: Node<'_, '_>| row.children().filter(Node::is_element).count();
    let rows: Vec<usize> =
        document.descendants().filter(|node| node.tag_name().name() == "tr").map(cells).collect();
    assert_eq!(rows, [2, 3, 3]);
    // A row of one cell is a heading over all columns.
    table.push(vec!["heading".into()]);
    assert!(Page::new("t").table("c", &table, &[]).render().contains("colspan=\"3\">heading</th></tr>"));
}

/// Page in a browser: no messages on the console, and all figures are within the window.
#[test]
#[ignore = "needs a browser: .ci/run browser"]
fn browser_lays_out_every_figure() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("report.html");
    std::fs::write(&file, sample_page(4_000).render()).expect("written");
    let mut browser = Browser::start(&folder.path().join("profile"), 1200, 900);
    browser.open(&format!("file://{}", file.display()));
    let sizes = browser.evaluate(
        "[...document.querySelectorAll('svg')].map(svg => { const box = svg.getBoundingClientRect(); \
         return [box.width, box.height] })",
    );
    assert_eq!(browser.complaints(), [""; 0]);
    let sizes: Vec<[f64; 2]> = serde_json::from_value(sizes).expect("widths and heights");
    assert_eq!(sizes.len(), 4);
    for [width, height] in sizes {
        assert!((600.0..=1200.0).contains(&width) && height > 100.0, "{width} x {height}");
    }
}
