use std::io::{Cursor, Read};

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use flate2::read::ZlibDecoder;
use srflow_core::{FlowField, Image, Plane, Size, flow_colors};

use super::font::width;
use super::*;

const METHODS: [&str; 2] = ["Ours", "a < b & \"c\""];

/// A pair whose true flow grows to `longest` pixels at its right edge; the methods are off by a fifth and by a half of it.
fn pair(name: &str, [width, height]: [usize; 2], longest: f32) -> Pair {
    let flow = |gain: f32| {
        let length = move |x: usize| gain * longest * x as f32 / (width - 1) as f32;
        FlowField::from_fn(width, height, |x, y| {
            [length(x) * 0.6, if y % 2 == 0 { 0.8 } else { -0.8 } * length(x)]
        })
    };
    let frame = |shade: u8| Image::from_fn(width, height, |x, y| [x as u8, y as u8, shade]);
    Pair {
        name: name.to_owned(),
        frames: [frame(10), frame(200)],
        truth: Some(flow(1.0)),
        flows: vec![Some(flow(0.8)), Some(flow(0.5))],
    }
}

/// The change of flow towards the lower right.
fn strain(flow: &FlowField) -> Plane {
    let Size { width, height } = flow.size();
    Plane::from_fn(width, height, |x, y| {
        let ([u, v], [next_u, next_v]) =
            (flow.get(x, y), flow.get((x + 1).min(width - 1), (y + 1).min(height - 1)));
        (next_u - u).hypot(next_v - v)
    })
}

fn plan(columns: &[&str]) -> Plan {
    let methods: Vec<String> = METHODS.map(str::to_owned).into();
    let columns: Vec<Column> = columns.iter().map(|column| column.parse().unwrap()).collect();
    Plan {
        columns: resolve(&columns, &methods).unwrap(),
        methods,
        most_columns: 10,
        scales: Scales { flow: Scale::Auto, error: Scale::Auto, strain: Scale::Auto },
        strain,
        arrows: None,
        scores: true,
        letters: false,
        titles: None,
        labels: None,
        captions: None,
    }
}

/// Every kind of panel, over pairs of different shapes, continued in further rows.
fn full() -> Composed {
    let plan = Plan {
        most_columns: 4,
        arrows: Some(8),
        letters: true,
        scales: Scales { flow: Scale::Auto, error: Scale::Pair, strain: Scale::Fixed(0.2) },
        ..plan(&["frame1+truth", "frame2", "overlay", "flow+error", "strain", "strain:truth"])
    };
    plan.compose(&[pair("a & <b>", [40, 60], 4.0), pair("wide", [90, 30], 1.6)]).unwrap()
}

fn areas(drawing: &Drawing) -> Vec<Area> {
    let areas = drawing.items.iter().map(|item| match item {
        Item::Picture { area, .. } => Some(*area),
        _ => None,
    });
    areas.flatten().collect()
}

/// Checks the places of all items.
fn all_is_on_the_page(drawing: &Drawing) {
    let within = |at: f64, end: f64| (-1e-6..=end + 1e-6).contains(&at);
    let inside = |[x, y]: [f64; 2]| within(x, drawing.width) && within(y, drawing.height);
    for item in &drawing.items {
        match item {
            Item::Text { text, at: [x, y], size, anchor, upright } => {
                let long = width(text) * size;
                let before = if *anchor == Anchor::Middle { long / 2.0 } else { 0.0 };
                let ends = match upright {
                    false => [[x - before, y - 0.7 * size], [x - before + long, y + 0.2 * size]],
                    true => [[x - 0.7 * size, y + before], [x + 0.2 * size, y + before - long]],
                };
                assert!(ends.into_iter().all(inside), "{item:?} within {}x{}", drawing.width, drawing.height);
            }
            Item::Path { lines, .. } => assert!(lines.iter().flatten().copied().all(inside), "{item:?}"),
            Item::Picture { area: Area { x, y, width, height }, .. } => {
                assert!(inside([*x, *y]) && inside([x + width, y + height]), "{item:?}");
            }
        }
    }
}

#[test]
fn panels_do_not_overlap_and_all_is_on_the_page() {
    let composed = full();
    for style in [Style::default(), Style { width: 180.0, font_size: 6.0, gap: 1.0, pixels_per_inch: 100.0 }]
    {
        let drawing = composed.figure.drawing(&style).unwrap();
        assert_eq!(drawing.width, style.width);
        let areas = areas(&drawing);
        // Eleven panels for each pair, the wheel, a bar of strain, and a bar of errors for each pair.
        assert_eq!(areas.len(), 2 * 11 + 2 + 2);
        all_is_on_the_page(&drawing);
        for (number, a) in areas.iter().enumerate() {
            for b in &areas[..number] {
                let apart = |a: f64, a_size: f64, b: f64, b_size: f64| {
                    a + a_size <= b + 1e-9 || b + b_size <= a + 1e-9
                };
                assert!(
                    apart(a.x, a.width, b.x, b.width) || apart(a.y, a.height, b.y, b.height),
                    "{a:?} {b:?}"
                );
            }
        }
    }
}

#[test]
fn legends_fit_into_narrow_figures_and_wrap() {
    let plan = Plan { arrows: Some(8), letters: true, ..plan(&["flow:Ours+error:Ours+strain:Ours"]) };
    let composed = plan.compose(&[pair("a", [40, 60], 4.0)]).unwrap();
    for (width, font_size) in [(25.0, 8.0), (120.0, 36.0), (200.0, 8.0)] {
        all_is_on_the_page(
            &composed.figure.drawing(&Style { width, font_size, ..Style::default() }).unwrap(),
        );
    }
}

#[test]
fn panels_keep_their_proportions_and_columns_their_places() {
    let composed = plan(&["frame1", "truth+frame2"])
        .compose(&[pair("a", [40, 60], 4.0), pair("b", [90, 30], 4.0)])
        .unwrap();
    let drawing = composed.figure.drawing(&Style::default()).unwrap();
    let areas = areas(&drawing);
    assert_eq!(areas.len(), 6 + 1, "the panels and the wheel");
    for (area, (width, height)) in
        areas.iter().zip([(2.0, 3.0), (2.0, 3.0), (2.0, 3.0), (3.0, 1.0), (3.0, 1.0), (3.0, 1.0)])
    {
        assert!((area.width / area.height - width / height).abs() < 1e-9, "{area:?}");
        assert_eq!(area.width, areas[0].width);
    }
    assert_eq!([areas[0].x, areas[1].x, areas[1].y], [areas[3].x, areas[4].x, areas[0].y]);
    assert_eq!((areas[1].x, areas[4].x), (areas[2].x, areas[5].x));
}

#[test]
fn all_flow_of_a_figure_has_one_scale_and_the_colours_of_the_wheel() {
    let pairs = [pair("a", [40, 60], 3.9), pair("b", [90, 30], 1.5)];
    let columns = ["truth", "flow"];
    let flows = |pair: &Pair| [pair.truth.clone(), pair.flows[0].clone(), pair.flows[1].clone()];
    for (scale, expected) in
        [(Scale::Auto, [5.0, 5.0]), (Scale::Pair, [5.0, 2.0]), (Scale::Fixed(7.5), [7.5, 7.5])]
    {
        let plan = plan(&columns);
        let composed =
            Plan { scales: Scales { flow: scale, ..plan.scales }, ..plan }.compose(&pairs).unwrap();
        assert_eq!([composed.ends[0].flow, composed.ends[1].flow], expected);
        for ((row, pair), longest) in composed.figure.rows.iter().zip(&pairs).zip(expected) {
            for (cell, flow) in row.cells.iter().zip(flows(pair)) {
                assert_eq!(cell[0].picture, flow_colors(&flow.unwrap(), Some(longest as f32)));
            }
            assert_eq!(row.legends.len(), usize::from(scale == Scale::Pair));
        }
        assert_eq!(composed.figure.legends.len(), usize::from(scale != Scale::Pair));
    }
}

#[test]
fn scores_are_below_errors_or_else_below_flow() {
    let captions = |columns: &[&str]| -> Vec<String> {
        let composed = plan(columns).compose(&[pair("a", [11, 4], 2.0)]).unwrap();
        composed.figure.panels().map(|panel| panel.caption.clone()).collect()
    };
    // The mean length of the true flow is half the longest.
    assert_eq!(captions(&["frame1", "flow"]), ["", "EPE 0.200 px", "EPE 0.500 px"]);
    assert_eq!(captions(&["flow+error", "truth"]), ["", "", "", "EPE 0.200 px", "EPE 0.500 px"]);
    let plan = Plan { letters: true, scores: false, ..plan(&["frame1+truth", "flow"]) };
    let composed = plan.compose(&[pair("a", [11, 4], 2.0)]).unwrap();
    let letters: Vec<&str> = composed.figure.panels().map(|panel| panel.caption.as_str()).collect();
    assert_eq!(letters, ["(a)", "(b)", "(c)", "(d)"]);
    assert_eq!(composed.figure.rows[0].cells[0][1].caption, "(d)", "from left to right, then down");
}

#[test]
fn unknown_flow_is_black_or_grey_and_has_no_score() {
    let mut holes = pair("holes", [8, 4], 2.0);
    if let Some(flow) = &mut holes.flows[0] {
        flow.set(1, 1, [f32::NAN; 2]);
    }
    let composed = plan(&["flow", "error", "strain"]).compose(&[holes]).unwrap();
    assert!(composed.epe[0][0].is_none() && composed.epe[0][1].is_some());
    let cells = &composed.figure.rows[0].cells;
    assert_eq!(cells[0][0].picture.get(1, 1), [0; 3]);
    assert_eq!(cells[2][0].picture.get(1, 1), cells[4][0].picture.get(0, 0), "grey, as strain beside it");
    let svg = composed.figure.drawing(&Style::default()).unwrap().svg().unwrap();
    assert!(svg.contains("black: unknown") && svg.contains("End-point error (px); grey: unknown"));
    let all = plan(&["flow"]);
    let nothing = FlowField::filled(8, 4, [f32::NAN; 2]);
    let pair =
        Pair { flows: vec![Some(nothing.clone()), Some(nothing)], truth: None, ..pair("nan", [8, 4], 1.0) };
    let composed = all.compose(&[pair]).unwrap();
    assert_eq!(composed.ends[0].flow, 0.1, "the least");
}

#[test]
fn arrows_are_as_long_as_flow_and_stay_on_their_panel() {
    let plan = Plan { arrows: Some(8), ..plan(&["truth", "frame1"]) };
    let composed = plan.compose(&[pair("a", [41, 54], 5.0)]).unwrap();
    let [truth, frame] = [0, 1].map(|cell| &composed.figure.rows[0].cells[cell][0]);
    assert!(frame.arrows.is_empty());
    let arrow = truth.arrows.iter().find(|arrow| arrow.from == [20.0, 4.0]).unwrap();
    // Half of the scale's end, 5 px: half of the distance of arrows.
    assert!((arrow.to[0] - 22.4).abs() < 1e-5 && (arrow.to[1] - 7.2).abs() < 1e-5, "{arrow:?}");
    let drawing = composed.figure.drawing(&Style::default()).unwrap();
    let panel = areas(&drawing)[0];
    let heads = drawing.items.iter().find_map(|item| match item {
        Item::Path { lines, paint: Paint::Fill, .. } => Some(lines),
        _ => None,
    });
    let heads = heads.expect("heads of arrows");
    assert!(heads.len() > 10 && heads.len() < truth.arrows.len(), "arrows beyond the edge are left out");
    for [x, y] in heads.iter().map(|head| head[0]) {
        assert!(
            (panel.x..panel.x + panel.width).contains(&x) && (panel.y..panel.y + panel.height).contains(&y)
        );
    }
}

#[test]
fn an_svg_is_xml_with_every_panel_and_text() {
    let composed = full();
    let svg = composed.figure.drawing(&Style::default()).unwrap().svg().unwrap();
    assert_eq!(svg, full().figure.drawing(&Style::default()).unwrap().svg().unwrap(), "the same bytes again");
    let mut reader = quick_xml::Reader::from_str(&svg);
    reader.config_mut().check_end_names = true;
    let mut elements = 0;
    loop {
        match reader.read_event().unwrap() {
            quick_xml::events::Event::Eof => break,
            quick_xml::events::Event::Start(_) => elements += 1,
            _ => {}
        }
    }
    assert!(elements > 60, "{elements}");
    for text in [
        "Ground truth",
        "a &lt; b &amp; &quot;c&quot;",
        "a &amp; &lt;b&gt;",
        "radius: 5 px",
        "Optical strain",
        "(v)",
    ] {
        assert!(svg.contains(text), "{text}");
    }
    let pictures: Vec<Image> = svg
        .split("data:image/png;base64,")
        .skip(1)
        .map(|part| decoded(&BASE64_STANDARD.decode(part.split('"').next().unwrap()).unwrap()))
        .collect();
    for panel in composed.figure.panels() {
        assert!(pictures.contains(&panel.picture), "{}", panel.name);
    }
}

fn decoded(png: &[u8]) -> Image {
    let mut decoder = png::Decoder::new(Cursor::new(png));
    decoder.ignore_checksums(true);
    let mut reader = decoder.read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let frame = reader.next_frame(&mut bytes).unwrap();
    Image::from_pixels(frame.width as usize, frame.height as usize, bytes.as_chunks().0.to_vec()).unwrap()
}

fn position(bytes: &[u8], part: &str, from: usize) -> Option<usize> {
    bytes[from..].windows(part.len()).position(|window| window == part.as_bytes()).map(|place| from + place)
}

/// The dictionary and the stream of each object that has one.
fn streams(pdf: &[u8]) -> Vec<(String, Vec<u8>)> {
    let mut streams = Vec::new();
    let mut from = 0;
    while let Some(start) = position(pdf, "\nstream\n", from) {
        let object = pdf[..start].windows(5).rposition(|window| window == b" obj\n").unwrap();
        let dictionary = String::from_utf8_lossy(&pdf[object..start]).into_owned();
        let length = dictionary.split("/Length ").nth(1).unwrap();
        let length: usize = length.split(|c: char| !c.is_ascii_digit()).next().unwrap().parse().unwrap();
        let data = &pdf[start + 8..start + 8 + length];
        assert!(pdf[start + 8 + length..].starts_with(b"\nendstream"), "the length is right");
        streams.push((dictionary, data.to_vec()));
        from = start + 8 + length;
    }
    streams
}

#[test]
fn a_pdf_has_every_panel_and_text_and_its_table_of_objects_is_right() {
    let composed = full();
    let pdf = composed.figure.drawing(&Style::default()).unwrap().pdf().unwrap();
    assert_eq!(pdf, full().figure.drawing(&Style::default()).unwrap().pdf().unwrap(), "the same bytes again");
    assert!(pdf.starts_with(b"%PDF-1.4\n") && pdf.trim_ascii_end().ends_with(b"%%EOF"));
    let table = position(&pdf, "startxref", pdf.len() - 100).unwrap();
    let start: usize =
        String::from_utf8_lossy(&pdf[table..]).split_whitespace().nth(1).unwrap().parse().unwrap();
    let text = String::from_utf8_lossy(&pdf[start..table]).into_owned();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("xref"));
    let count: usize = lines.next().unwrap().strip_prefix("0 ").unwrap().parse().unwrap();
    assert_eq!(count, 1 + 5 + 26, "the free object, page and font, pictures");
    for (number, line) in lines.take(count).enumerate().skip(1) {
        let offset: usize = line.split(' ').next().unwrap().parse().unwrap();
        assert!(pdf[offset..].starts_with(format!("{number} 0 obj").as_bytes()), "object {number}: {line}");
    }

    let streams = streams(&pdf);
    let mut content = String::new();
    let mut pictures = Vec::new();
    for (dictionary, data) in &streams {
        let number = |key: &str| -> usize {
            let after = dictionary.split(key).nth(1).unwrap().trim_start();
            after.split(|c: char| !c.is_ascii_digit()).next().unwrap().parse().unwrap()
        };
        if dictionary.contains("/Subtype /Image") {
            assert!(dictionary.contains("/Predictor 15") && number("/Columns") == number("/Width"));
            pictures.push(decoded(&png_of(data, number("/Width "), number("/Height "))));
        } else {
            ZlibDecoder::new(&data[..]).read_to_string(&mut content).unwrap();
        }
    }
    assert_eq!(pictures.len(), 26);
    for panel in composed.figure.panels() {
        assert!(pictures.contains(&panel.picture), "{}", panel.name);
    }
    for text in ["(Frame 1 / Ground truth) Tj", "(radius: 5 px) Tj", "(a & <b>) Tj"] {
        assert!(content.contains(text), "{text} in {content}");
    }
    for part in ["/Date", "CreationDate", "ModDate"] {
        assert!(position(&pdf, part, 0).is_none());
    }
}

/// A PNG around a stream of filtered rows, without checksums.
fn png_of(stream: &[u8], width: usize, height: usize) -> Vec<u8> {
    let mut png = b"\x89PNG\r\n\x1a\n".to_vec();
    let header =
        [&(width as u32).to_be_bytes()[..], &(height as u32).to_be_bytes(), &[8, 2, 0, 0, 0]].concat();
    for (name, data) in [(b"IHDR", header.as_slice()), (b"IDAT", stream), (b"IEND", &[])] {
        png.extend((data.len() as u32).to_be_bytes());
        png.extend(name);
        png.extend(data);
        png.extend([0; 4]);
    }
    png
}

#[test]
fn a_pdf_refuses_characters_that_its_font_lacks() {
    let named = |name: &str| {
        let plan = Plan { methods: vec![name.to_owned(), "b".to_owned()], ..plan(&["flow"]) };
        plan.compose(&[pair("a", [8, 8], 1.0)]).unwrap().figure
    };
    let drawn = |figure: &Figure| figure.drawing(&Style::default()).unwrap().pdf();
    assert!(drawn(&named("Müller – 5 µm…")).is_ok());
    let figure = named("光流");
    let error = drawn(&figure).unwrap_err().to_string();
    assert!(error.contains("光流") && error.contains("U+5149") && error.contains(".svg"), "{error}");
    assert!(figure.drawing(&Style::default()).unwrap().svg().unwrap().contains("光流"));
    assert!(check_text("\u{202e}evil").is_ok(), "shown escaped");
}

#[test]
fn what_cannot_be_drawn_is_refused_in_a_sentence() {
    let refused = |figure: &Figure, style: &Style, part: &str| {
        let error = figure.drawing(style).unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
    };
    let style = Style::default();
    refused(&Figure::default(), &style, "at least one row");
    refused(&Figure { rows: vec![Row::default()], legends: Vec::new() }, &style, "at least one row");
    let panel = |[width, height]: [usize; 2]| Panel {
        name: String::new(),
        picture: Image::new(width, height),
        caption: String::new(),
        arrows: Vec::new(),
    };
    let grid = |columns: usize, size| {
        let cells = (0..columns).map(|_| vec![panel(size)]).collect();
        Figure { rows: vec![Row { cells, ..Row::default() }], legends: Vec::new() }
    };
    refused(&grid(1000, [1, 1]), &style, "1000 columns within 178.0 mm leave 0.0 mm");
    refused(&grid(1, [1, 1000]), &style, "the largest page of a PDF");
    refused(&grid(1, [4, 4]), &Style { width: 1e9, ..style }, "the largest page of a PDF");
    refused(&grid(2, [0, 3]), &style, "row 1, column 1 of the figure has a picture without pixels");
    let empty = Figure { rows: vec![Row { cells: vec![Vec::new()], ..Row::default() }], legends: Vec::new() };
    assert!(empty.drawing(&style).unwrap().items.is_empty());
}

#[test]
fn pairs_that_do_not_fit_the_plan_are_refused() {
    let refused = |plan: &Plan, pair: Pair, parts: &[&str]| {
        let error = plan.compose(&[pair]).unwrap_err().to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{error}");
    };
    let usual = || pair("p", [8, 6], 1.0);
    refused(&plan(&["error"]), Pair { truth: None, ..usual() }, &["p has no true flow"]);
    refused(&plan(&["flow"]), Pair { flows: vec![None, None], ..usual() }, &["the flow of Ours"]);
    let small = Some(FlowField::new(4, 4));
    refused(&plan(&["truth"]), Pair { truth: small, ..usual() }, &["the true flow is 4x4", "8x6"]);
    let titles = Some(vec![String::new()]);
    refused(
        &Plan { titles, ..plan(&["flow"]) },
        usual(),
        &["`titles`: expected 2, one for each column, found 1"],
    );
    let captions = Some(vec![String::new(); 3]);
    refused(
        &Plan { captions, ..plan(&["flow"]) },
        usual(),
        &["`captions`: expected 2, one for each panel, found 3"],
    );
}

#[test]
fn pictures_are_averaged_down_to_the_resolution_and_never_up() {
    let composed = plan(&["frame1", "frame2"]).compose(&[pair("a", [200, 100], 1.0)]).unwrap();
    let width = |pixels_per_inch: f64| {
        let drawing =
            composed.figure.drawing(&Style { width: 147.0, pixels_per_inch, ..Style::default() }).unwrap();
        drawing.items.iter().find_map(|item| match item {
            Item::Picture { image, .. } => Some(image.width()),
            _ => None,
        })
    };
    // A panel is one inch wide.
    assert_eq!([50.0, 100.0, 600.0].map(width), [Some(50), Some(100), Some(200)]);
}
