//! The contents of the demo's report, from top to bottom.

use srflow_eval::{Evaluation, score_figures};
use srflow_report::html::{
    ActionCard, Axis, Bar, Bin, Chart, Figure, Film, Page, Panel, Section, action_cards, bars, compare,
    embedded, facts, films, histogram, panels, side_by_side, tiles, wheel_legend,
};

use super::datasets::{Rendered, Still};
use super::stage::Stages;

/// All data of the page.
pub struct Shown {
    /// Three heads at full size.
    pub heads: Vec<Still>,
    /// The dataset of the stills.
    pub stills: Rendered,
    /// The dataset with motion.
    pub clips: Rendered,
    /// One scene of it as animations, and the length in pixels of the strongest flow colour.
    pub films: (Vec<Film>, f64),
    /// Number of Gaussians of the first head.
    pub gaussians: usize,
    /// The first head as a page of its own.
    pub avatar: String,
    /// Action units.
    pub cards: Vec<ActionCard>,
    /// Scores on the paper's crop of the stills, and pictures of the pairs.
    pub at_full_size: (Evaluation, Vec<Figure>),
    /// Scores on the dataset with motion.
    pub in_motion: (Evaluation, Vec<Figure>),
    /// Scores on photographs, if there are any.
    pub on_photographs: Option<(Evaluation, Vec<Figure>)>,
    /// The commands that render the same datasets.
    pub commands: Vec<String>,
    /// The machine that the times were measured on.
    pub machine: String,
}

/// The page.
///
/// # Errors
/// When a picture cannot be encoded.
pub fn page(shown: &Shown, stages: &Stages) -> anyhow::Result<Page> {
    let mut sections = vec![heads(shown), pair(shown), action_units(shown), motion(shown), full_size(shown)];
    sections.extend(photographs(shown));
    sections.push(making(shown, stages));
    Ok(Page {
        kicker: "srflow demo".to_owned(),
        title: "From a head of Gaussians to evaluated optical flow".to_owned(),
        lead: "Everything on this page was computed in one run, on this machine, from one seed: heads made of 3D \
        Gaussians, rendered frames, the exact motion of every pixel, and the flow that each method estimates from \
        these frames, with its errors."
            .to_owned(),
        opening: opening(shown, stages)?,
        sections,
        colophon: format!("srflow {} · {} · self-contained", env!("CARGO_PKG_VERSION"), shown.machine),
    })
}

fn opening(shown: &Shown, stages: &Stages) -> anyhow::Result<Vec<Figure>> {
    let pairs = shown.stills.report.run.units + shown.clips.report.run.units;
    let numbers = [
        (shown.heads.len().to_string(), "heads, none of them a real person's".to_owned()),
        (thousands(shown.gaussians), "Gaussians on the first".to_owned()),
        (pairs.to_string(), "frame pairs with exact flow".to_owned()),
        (size(&shown.stills), "pixels in the large frames".to_owned()),
        (format!("{:.0} s", stages.seconds()), "for everything on this page".to_owned()),
    ];
    let (films_of_scene, longest) = &shown.films;
    Ok(vec![
        tiles(&numbers),
        films(films_of_scene, 24.0, ""),
        wheel_legend(*longest, "The animations run back and forth; hover over one to pause it.")?,
    ])
}

fn heads(shown: &Shown) -> Section {
    let portraits: Vec<Panel> = shown.heads.iter().map(|head| head.portrait.clone()).collect();
    let details: Vec<Panel> = shown.heads.iter().map(|head| head.detail.clone()).collect();
    Section::new(
        "Three heads",
        "Each is a triangle mesh dressed in Gaussians, its shape, skin, hair and eyes drawn from one seed. At \
            2200×3208 the frames are as large as NeRSemble's, the recordings that the SRFlow paper starts from.",
        vec![
            panels(&portraits, 240, "The canonical frontal camera, scaled down for this page."),
            panels(&details, 320, "The centre of the same frames at full resolution."),
        ],
    )
}

fn pair(shown: &Shown) -> Section {
    let sliders = shown.heads.iter().map(|head| {
        let (frame, flow) = &head.over_flow;
        compare((frame, "frame 1"), (flow, "flow"), "")
    });
    let mut figures = vec![side_by_side(sliders.collect(), 260)];
    figures.extend(shown.heads.iter().map(|head| panels(&head.panels, 200, "")));
    Section::new(
        "The ground truth of every pair",
        "Two frames, and for each pixel of the first: where it goes, whether it belongs to the head, and whether \
            the second frame hides it. The flow is not estimated: it is the motion of the Gaussians themselves, \
            blended like their colours in the same pass. Drag the dividers.",
        figures,
    )
}

fn action_units(shown: &Shown) -> Section {
    Section::new(
        "Action units",
        "The muscles of facial expression by their numbers in the Facial Action Coding System, each at full \
            intensity beside its flow from rest. They combine, and micro-expressions are short, faint episodes of them.",
        vec![
            embedded(
                &shown.avatar,
                "The first head, to turn and to move",
                "Drag to turn, scroll to zoom; the sliders are action units, and the flow is the exact one of the motion to the next frame or \
                to rest. The command srflow view makes such a page of any head, file of Gaussians or dataset.",
            ),
            action_cards(
                &shown.cards,
                "Millimetres are those of the vertex that moves most. Each flow has its own scale, to make small motion visible.",
            ),
        ],
    )
}

fn motion(shown: &Shown) -> Section {
    let (evaluation, pictures) = &shown.in_motion;
    let mut figures = pictures.clone();
    figures.extend(score_figures(evaluation, &shown.machine));
    Section::new(
        "Estimators against the ground truth",
        format!(
            "The same heads in motion before moving cameras, at {}. The methods see the two frames; they never see the flow.",
            size(&shown.clips)
        ),
        figures,
    )
}

fn full_size(shown: &Shown) -> Section {
    let (evaluation, pictures) = &shown.at_full_size;
    let mut figures = pictures.clone();
    figures.extend(score_figures(evaluation, &shown.machine));
    Section::new(
        "At full size",
        "The large frames, cropped around the head to the window of the paper's evaluation, 1200×1600 of \
            2200×3208 pixels. The same motion is four times as many pixels here as above.",
        figures,
    )
}

fn photographs(shown: &Shown) -> Option<Section> {
    let (evaluation, pictures) = shown.on_photographs.as_ref()?;
    let mut figures = pictures.clone();
    figures.extend(score_figures(evaluation, &shown.machine));
    Some(Section::new(
        "Real photographs",
        "The same methods, scores and pictures on real photographs with measured ground truth.",
        figures,
    ))
}

fn making(shown: &Shown, stages: &Stages) -> Section {
    let mut named: Vec<(String, String)> =
        shown.commands.iter().map(|command| ("The same dataset".to_owned(), command.clone())).collect();
    named.push(("Machine".to_owned(), shown.machine.clone()));
    for rendered in [&shown.stills, &shown.clips] {
        named.push((format!("Rendering {}", size(rendered)), rendering(rendered)));
    }
    Section::new(
        "How it was made",
        "Frames and flow depend on the seed alone: they do not depend on the machine or the number of threads.",
        vec![side_by_side(vec![stage_times(stages), magnitudes(&shown.clips)], 420), facts(&named)],
    )
}

fn rendering(rendered: &Rendered) -> String {
    let report = &rendered.report;
    if report.run.made == 0 {
        return format!("{} pairs, all from an earlier run", report.run.units);
    }
    format!(
        "{} pairs in {:.1} s, including heads, encoding and writing: {:.1} pairs a minute, {:.1} MB a pair",
        report.run.made,
        report.run.seconds,
        60.0 * report.run.made as f64 / report.run.seconds.max(1e-9),
        report.run.bytes as f64 / 1e6 / report.run.made as f64
    )
}

fn stage_times(stages: &Stages) -> Figure {
    let stage = |stage: &super::stage::StageTime| Bar {
        name: stage.name.clone(),
        value: stage.seconds,
        label: format!("{:.1} s", stage.seconds),
        baseline: false,
    };
    let chart = Chart::new("Where the time went", "", "", "Wall-clock time of each stage of this run.");
    bars(&stages.done.iter().map(stage).collect::<Vec<_>>(), &chart)
}

/// Histogram of the flow length on the heads.
fn magnitudes(rendered: &Rendered) -> Figure {
    let chart = |caption: String| {
        Chart::new(
            format!("How far pixels move, {}", size(rendered)),
            "length of the flow on the head, px (logarithmic)",
            "pixels, %",
            caption,
        )
    };
    let Some(statistics) = &rendered.report.statistics else {
        return histogram(
            &[],
            Axis::Logarithmic,
            Axis::Linear,
            &chart("The dataset is incomplete.".to_owned()),
        );
    };
    let pixels = statistics.flow.pixels.max(1) as f64;
    let edges = statistics.bin_edges;
    let bins: Vec<Bin> = edges
        .iter()
        .zip(statistics.flow.histogram)
        .enumerate()
        .map(|(i, (low, count))| Bin {
            low: f64::from(*low),
            high: f64::from(edges.get(i + 1).copied().unwrap_or(2.0 * low)),
            count: 100.0 * count as f64 / pixels,
        })
        .collect();
    let caption = format!(
        "Mean {:.2} px, greatest {:.1} px; {:.2} % of the head's pixels are hidden in the next frame.",
        statistics.mean_magnitude,
        statistics.flow.max,
        100.0 * statistics.occluded_share
    );
    histogram(&bins, Axis::Logarithmic, Axis::Linear, &chart(caption))
}

fn size(rendered: &Rendered) -> String {
    rendered.report.statistics.as_ref().map_or(String::new(), |all| format!("{}×{}", all.width, all.height))
}

/// A count with a comma before every third digit from the right.
fn thousands(count: usize) -> String {
    let digits = count.to_string();
    let groups: Vec<&str> =
        digits.as_bytes().rchunks(3).rev().filter_map(|group| str::from_utf8(group).ok()).collect();
    groups.join(",")
}

#[cfg(test)]
mod tests {
    #[test]
    fn counts_are_read_in_threes() {
        let shown = [0, 999, 1000, 127_448, 11_161_000].map(super::thousands);
        assert_eq!(shown, ["0", "999", "1,000", "127,448", "11,161,000"]);
    }
}
