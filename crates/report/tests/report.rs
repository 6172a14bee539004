//! A report of made-up numbers is complete, well-formed and self-contained.

use srflow_core::{Image, Plane, is_unprintable};
use srflow_report::html::{
    ActionCard, Axis, Bar, Bin, Chart, Curve, Figure, Film, Page, Panel, Picture, Section, action_cards,
    bars, compare, curves, facts, films, heat_legend, histogram, panels, score_table, side_by_side, tiles,
};
use srflow_report::{Better, Column, Row, Table, heat};

/// Text that would break out of any context if it were not escaped.
const HOSTILE: &str = "<script>alert('x')</script> \" onload=x & </style> \u{202e}\u{1b}[2J";

fn blob(width: usize, height: usize, hue: u8) -> Image {
    Image::from_fn(width, height, |x, y| {
        let (dx, dy) = (x as f32 / width as f32 - 0.5, y as f32 / height as f32 - 0.5);
        let light = (230.0 - 380.0 * (dx * dx + dy * dy)).max(0.0) as u8;
        [light, light.saturating_sub(hue), light.saturating_sub(2 * hue)]
    })
}

fn chart(title: &str, x: &str, y: &str) -> Chart {
    Chart::new(title, x, y, format!("Made up. {HOSTILE}"))
}

fn table() -> Table {
    let columns = [("EPE", Better::Lower), ("px1", Better::Higher), ("WAUC", Better::Higher)];
    let column = |(header, better): (&str, Better)| Column {
        key: header.to_lowercase(),
        header: header.into(),
        better: Some(better),
        decimals: 4,
    };
    let row = |name: &str, values: [f64; 3], baseline| Row {
        name: name.into(),
        values: values.map(Some).to_vec(),
        baseline,
    };
    Table {
        title: HOSTILE.into(),
        columns: columns.map(column).to_vec(),
        rows: vec![
            row("zero", [1.25, 0.4, 51.0], true),
            row("farneback", [0.41, 0.91, 83.0], false),
            row("tvl1", [0.31, 0.93, 81.0], false),
            row(HOSTILE, [0.51, 0.89, 80.0], false),
        ],
        ..Table::default()
    }
}

fn charts() -> Figure {
    let bins: Vec<Bin> = (0..30)
        .map(|i| Bin { low: i as f64, high: i as f64 + 1.0, count: 1e6 * (-0.3 * i as f64).exp() })
        .collect();
    let curve = |name: &str, k: f64, baseline| Curve {
        name: name.into(),
        points: (0..=100).map(|i| (i as f64 / 20.0, 100.0 * (1.0 - (-k * i as f64 / 20.0).exp()))).collect(),
        baseline,
    };
    let bar =
        |name: &str, value, baseline| Bar { name: name.into(), value, label: format!("{value} s"), baseline };
    side_by_side(
        vec![
            histogram(
                &bins,
                Axis::Linear,
                Axis::Logarithmic,
                &chart("Flow magnitude", "length of the flow, px", "pixels"),
            ),
            curves(
                &[curve("farneback", 2.0, false), curve("tvl1", 3.0, false), curve("zero", 0.4, true)],
                Axis::Linear,
                false,
                &chart("Pixels within an error", "end-point error, px", "share of pixels, %"),
            ),
            bars(
                &[bar("farneback", 0.35, false), bar("tvl1", 7.0, false), bar("zero", 0.0, true)],
                &chart("Time per pair", "", ""),
            ),
        ],
        420,
    )
}

fn report() -> Page {
    let photo = |hue, words: &str| Picture::jpeg(&blob(260, 380, hue), words).unwrap();
    let panel = |title: &str, picture| Panel::new(picture, title, "a few words");
    let error = Plane::from_fn(260, 380, |x, y| if y > 370 { f32::NAN } else { (x * y) as f32 / 40_000.0 });
    let frames: Vec<Image> = (0..12).map(|i| blob(130, 190, 4 * i)).collect();
    let card = |i: usize| ActionCard {
        title: format!("AU {i}"),
        note: "lip corner puller".into(),
        rest: photo(10, "rest"),
        full: photo(50, "full"),
        flow: photo(90, "flow"),
    };
    let heads = vec![panels(
        &[
            panel("Seed 1", photo(10, HOSTILE)),
            panel("Seed 2", photo(40, "b")),
            panel(HOSTILE, photo(70, "c")),
        ],
        240,
        HOSTILE,
    )];
    let scores = vec![
        score_table(&table(), HOSTILE),
        charts(),
        panels(&[panel("Error", Picture::exact(&heat(&error, 3.0), "error").unwrap())], 240, ""),
        heat_legend(3.0, "Grey has no truth.").unwrap(),
    ];
    let motion = vec![
        compare((&photo(10, "a"), "frame"), (&photo(90, "b"), "flow"), "Drag the divider."),
        action_cards(&(1..=6).map(card).collect::<Vec<_>>(), "Made up."),
    ];
    let section = |title: &str, figures| Section::new(title, "Two sentences.", figures);
    Page {
        title: "A report of made-up numbers".into(),
        kicker: "srflow test".into(),
        lead: HOSTILE.into(),
        opening: vec![
            tiles(&[("12".into(), "pairs".into()), ("2200×3208".into(), "pixels".into())]),
            films(
                &[Film::new(&frames, "RGB", "").unwrap(), Film::new(&frames, "Flow", "x").unwrap()],
                12.0,
                "",
            ),
        ],
        sections: vec![
            section("Heads", heads),
            section("Motion", motion),
            section("Scores", scores),
            section(HOSTILE, vec![facts(&[("Machine".into(), HOSTILE.into())])]),
        ],
        colophon: HOSTILE.into(),
    }
}

/// Checks that tags are balanced; returns the names of the elements and of their attributes.
fn walk(html: &str) -> (Vec<String>, Vec<String>) {
    const VOID: [&str; 4] = ["meta", "img", "input", "br"];
    let (mut open, mut elements, mut attributes) = (Vec::new(), Vec::new(), Vec::new());
    let mut rest = html.strip_prefix("<!DOCTYPE html>").expect("document type");
    while let Some(at) = rest.find('<') {
        let end = at + rest[at..].find('>').expect("a tag ends");
        let tag = &rest[at + 1..end];
        rest = &rest[end + 1..];
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop().as_deref(), Some(name), "closing order");
            continue;
        }
        let name = tag.split_whitespace().next().expect("a name").to_owned();
        // Values are quoted: an odd number of quotes would mean that a text broke out of its attribute.
        assert_eq!(tag.matches('"').count() % 2, 0, "quotes of <{name}>");
        attributes.extend(tag.split('"').step_by(2).flat_map(|part| {
            part.split_whitespace().filter_map(|word| word.strip_suffix('=')).map(str::to_owned)
        }));
        if name == "style" {
            rest = &rest[rest.find("</style>").expect("the style sheet ends")..];
        }
        if !VOID.contains(&name.as_str()) {
            open.push(name.clone());
        }
        elements.push(name);
    }
    assert!(open.is_empty(), "left open: {open:?}");
    (elements, attributes)
}

#[test]
fn the_page_is_well_formed_and_escapes_every_text() {
    let html = report().html();
    let kept = std::env::current_exe().unwrap().with_file_name("report.html"); // to be looked at
    std::fs::write(kept, &html).unwrap();
    let (elements, attributes) = walk(&html);
    assert!(!elements.iter().any(|name| name == "script"), "a text became a script");
    assert!(!attributes.iter().any(|name| name == "onload"), "a text became an attribute");
    assert!(html.matches("&lt;script&gt;").count() >= 8);
    assert!(!html.contains(|c| is_unprintable(c) && c != '\n'), "a text reorders what is shown");
    assert_eq!(elements.iter().filter(|name| *name == "section").count(), 4);
}

#[test]
fn the_page_needs_nothing_beside_it() {
    let html = report().html();
    for outside in ["http:", "https:", "//cdn", "@import", "src=\"/", "src=\"file", "<link", "<iframe"] {
        assert!(!html.contains(outside), "the page asks for {outside}");
    }
    let sources = html.matches("src=\"").count();
    assert!(sources > 20 && sources == html.matches("src=\"data:image/").count());
    assert_eq!(html.matches("url(").count(), html.matches("url(data:image/").count());
}

#[test]
fn charts_hold_no_numbers_that_are_not() {
    let nothing = chart("t", "x", "y");
    let odd =
        Curve { name: "odd".into(), points: vec![(f64::NAN, 1.0), (0.0, f64::INFINITY)], baseline: false };
    let report = Page {
        opening: vec![
            curves(&[odd], Axis::Linear, true, &nothing),
            curves(&[], Axis::Logarithmic, true, &nothing),
            histogram(&[], Axis::Logarithmic, Axis::Linear, &nothing),
            histogram(
                &[Bin { low: 0.0, high: 0.0, count: f64::NAN }],
                Axis::Logarithmic,
                Axis::Logarithmic,
                &nothing,
            ),
            bars(
                &[Bar { name: "n".into(), value: f64::NAN, label: String::new(), baseline: false }],
                &nothing,
            ),
            bars(&[], &nothing),
        ],
        ..report()
    };
    let html = report.html();
    let drawings: Vec<&str> =
        html.split("<svg").skip(1).map(|part| part.split("</svg>").next().unwrap()).collect();
    for drawing in &drawings[..6] {
        let numbers = drawing
            .split('"')
            .skip(1)
            .step_by(2)
            .filter(|value| value.contains("NaN") || value.contains("inf"));
        assert_eq!(numbers.count(), 0, "{drawing}");
    }
}
