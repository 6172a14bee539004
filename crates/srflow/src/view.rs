//! Pages for a browser, in one file or served.

use std::fmt;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, anyhow, bail, ensure};
use serde::{Deserialize, Deserializer, Serialize};
use srflow_avatar::HeadSource;
use srflow_core::{FlowField, Mask, score};
use srflow_data::flow::{DatasetSpec, Entry, FlowDataset, Split, flow_files};
use srflow_eval::spread;
use srflow_files::{FileKind, FlowFormat, parse_error_in_words, read_flow, read_text, write_file};
use srflow_render::generate::MotionSource;
use srflow_splat::{SplatFormat, Up, read_gaussians};
use srflow_view::{Answer, Pack, Page, Server, ViewedFlow, ViewedPair};

use crate::clap::Args;
use crate::error::{in_words, wrong_settings};
use crate::head_page::head_pack;
use crate::methods::{self, Method, MethodParameters, MethodSpec, Source};
use crate::opening::open_dataset;
use crate::output::{ensure_extension, ensure_free, write_line};
use crate::posed_head::MovingHead;
use crate::scoring::folder_name;
use crate::{FollowUp, Job, Report, Watch};

/// Show Gaussians, an avatar, a dataset or flow in a browser
///
/// Writes one HTML page that needs no network: a file of Gaussians from all sides; an avatar with its motion, sliders for its action
/// units, gaze and head, and the true flow of both; the pairs of a dataset with flow, masks, depth and the flow of methods beside the
/// truth, with the values under the pointer.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = "\
THING is one of
  a file of Gaussians      scene.ply, .splat, .spz, .glb, .ksplat or .sog
  a head                   builtin, avatar:DIR, flame:FILE, ... as for `srflow rasterize --head`
  a dataset                srflow:DIR, sintel-clean:DIR, ... as for `srflow eval --dataset`
  a folder                 of an avatar, a dataset of srflow, flow files, or results of `srflow eval --out DIR --save-flow DIR/flow`
  a flow file              flow.flo, .npz, ...

Examples:
  srflow view builtin --seed 7
  srflow view runs/avatar -o avatar.html
  srflow view srflow:small --split test --method srflow tvl1 -o pairs.html
  srflow view srflow:large --serve")]
pub struct ViewJob {
    /// What to show
    #[arg(value_name = "THING")]
    pub thing: String,
    /// The page to write [default: the name of the thing with .html, in this folder]
    #[arg(short, long, value_name = "HTML")]
    #[serde(default)]
    pub output: Option<PathBuf>,
    /// Serve the page on this machine instead of writing it, and load pairs on demand; without PORT, or with
    /// 0, on any free port
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "0", conflicts_with = "output")]
    #[serde(default, deserialize_with = "port")]
    pub serve: Option<u16>,
    /// Split of a dataset: train, val, test or all [default: the one that results are usually reported on]
    #[arg(long)]
    #[serde(default)]
    pub split: Option<Split>,
    /// Show N pairs, spread evenly over the dataset [default: all if served, else as many as make 48 MB, at most 24]
    #[arg(long, value_name = "N")]
    #[serde(default)]
    pub limit: Option<NonZeroU32>,
    /// Motion of a head: `own`, `curves`, or a file, as for `srflow rasterize` [default: own if it has one, else curves]
    #[arg(long, value_name = "MOTION")]
    #[serde(default)]
    pub motion: Option<MotionSource>,
    /// Seed of the person and of the random motion, for built-in heads
    #[arg(long, value_name = "N", default_value_t = one())]
    #[serde(default = "one")]
    pub seed: u64,
    /// Overwrite the page
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
    #[arg(long, value_name = "METHOD", num_args = 1.., value_delimiter = ',', value_parser = methods::scored_method, help = Method::help_of_several("Methods whose flow is shown beside a dataset's"))]
    #[serde(default, deserialize_with = "methods::scored_methods")]
    pub method: Vec<MethodSpec>,
    #[command(flatten)]
    #[serde(flatten)]
    pub parameters: MethodParameters,
}

fn one() -> u64 {
    1
}

/// A port, or `true` for any free one.
fn port<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<u16>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged, expecting = "expected a port, 0 to 65535, or true")]
    enum Given {
        Serve(bool),
        Port(u16),
    }
    Ok(match Option::deserialize(deserializer)? {
        None | Some(Given::Serve(false)) => None,
        Some(Given::Serve(true)) => Some(0),
        Some(Given::Port(port)) => Some(port),
    })
}

/// Size of the pairs in a page where `limit` is not given, and their largest number.
const USUAL_BYTES: usize = 48 << 20;
const USUAL_PAIRS: usize = 24;

impl Job for ViewJob {
    const NAME: &'static str = "view";

    type Report = Viewed;

    fn work(&self, watch: &Watch) -> anyhow::Result<Viewed> {
        let output = self.output.clone().unwrap_or_else(|| usual_name(&self.thing));
        match self.serve {
            Some(_) if self.output.is_some() => wrong_settings!("`output` cannot be used with `serve`"),
            Some(_) => {}
            None => {
                ensure_extension(&output, "html")?;
                ensure_free([&output], self.force)?;
            }
        }
        let view = self.open(watch)?;
        let limit = self.limit.map(|limit| limit.get() as usize);
        match self.serve {
            Some(port) => {
                let server = Server::new(port)?;
                Ok(Viewed::Served(Box::new(Served { url: server.url(), server, view, limit })))
            }
            None => {
                let html = view.page(limit, watch)?.html();
                write_file(&output, html.as_bytes())?;
                Ok(Viewed::Written(Written { page: output, bytes: html.len() }))
            }
        }
    }
}

/// What [`ViewJob`] has made.
#[derive(Serialize)]
#[serde(untagged)]
pub enum Viewed {
    /// A page in a file.
    Written(Written),
    /// A page to be served.
    Served(Box<Served>),
}

/// A page in a file.
#[derive(Debug, Clone, Serialize)]
pub struct Written {
    pub page: PathBuf,
    pub bytes: usize,
}

/// A page whose server listens; it answers while its [follow-up](Report::follow_up) runs.
#[derive(Serialize)]
pub struct Served {
    pub url: String,
    #[serde(skip)]
    server: Server,
    #[serde(skip)]
    view: Opened,
    #[serde(skip)]
    limit: Option<usize>,
}

impl Report for Viewed {
    fn follow_up(self) -> Option<FollowUp> {
        let Self::Served(served) = self else { return None };
        Some(Box::new(move |stop| {
            let Served { server, view, limit, .. } = *served;
            Ok(server.run(|name| view.answer(name, limit), stop).map_err(anyhow::Error::from)?)
        }))
    }
}

impl fmt::Display for Viewed {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Written(Written { page, bytes }) => write_line(
                f,
                format_args!("{} ({:.1} MB): open it in a browser", page.display(), *bytes as f64 / 1e6),
            ),
            Self::Served(served) => writeln!(f, "{}: open it in a browser; Ctrl-C ends", served.url),
        }
    }
}

/// `avatar.html` for `runs/avatar` and for `avatar:runs/avatar`.
fn usual_name(thing: &str) -> PathBuf {
    let name = thing.trim_end_matches('/').rsplit(['/', '\\', ':']).next().unwrap_or_default();
    let stem = Path::new(name).file_stem().unwrap_or("view".as_ref());
    Path::new(stem).with_added_extension("html")
}

/// What is shown, opened.
enum Opened {
    /// A page in one piece.
    Whole {
        title: String,
        main: Pack,
    },
    Pairs(Pairs),
}

/// Pairs that are read one by one.
struct Pairs {
    title: String,
    kind: PairKind,
}

enum PairKind {
    /// With the methods whose flow is shown.
    Dataset(FlowDataset, Vec<Source>),
    Flows(Vec<PathBuf>),
}

impl ViewJob {
    /// Opens what is to be shown.
    fn open(&self, watch: &Watch) -> anyhow::Result<Opened> {
        let opened = match Thing::find(&self.thing)? {
            Thing::Splats(file) => {
                let title = name_of(&file);
                let up = SplatFormat::of(&file).and_then(|format| format.up).unwrap_or(Up::PlusY);
                let main = srflow_view::splats(&title, &read_gaussians(&file)?, up)
                    .with_context(|| file.display().to_string())?;
                Opened::Whole { title, main }
            }
            Thing::Head(source) => {
                let head = MovingHead::open(&source, self.motion.as_ref(), self.seed)?;
                let title = source.to_string();
                let main = head_pack(&head, &title)?;
                Opened::Whole { title, main }
            }
            Thing::Dataset(spec) => {
                let dataset = open_dataset(&spec, self.split, watch)?;
                let limit = self.limit.map(|limit| limit.get() as usize);
                let methods = match self.method.is_empty() {
                    true => Vec::new(),
                    false => methods::sources(&self.method, &self.parameters, &dataset, limit, watch)?,
                };
                let title = format!("{spec}, {} split", dataset.split());
                return Ok(Opened::Pairs(Pairs { title, kind: PairKind::Dataset(dataset, methods) }));
            }
            Thing::Flows(files) => {
                Opened::Pairs(Pairs { title: self.thing.clone(), kind: PairKind::Flows(files) })
            }
            Thing::Results { dataset, split, limit, methods } => {
                let dataset = open_dataset(&dataset, Some(split), watch)?;
                let methods = methods::sources(&methods, &self.parameters, &dataset, limit, watch)?;
                let title = format!("{}, {} split", self.thing, dataset.split());
                Opened::Pairs(Pairs { title, kind: PairKind::Dataset(dataset, methods) })
            }
        };
        if !self.method.is_empty() {
            wrong_settings!("`method` is for datasets: its flow is shown beside theirs");
        }
        Ok(opened)
    }
}

/// What the text of `thing` names.
enum Thing {
    Splats(PathBuf),
    Head(HeadSource),
    Dataset(DatasetSpec),
    Flows(Vec<PathBuf>),
    Results { dataset: DatasetSpec, split: Split, limit: Option<usize>, methods: Vec<MethodSpec> },
}

impl Thing {
    fn find(text: &str) -> anyhow::Result<Self> {
        let path = Path::new(text);
        if path.is_dir() {
            return Self::in_folder(path);
        }
        let is_flow = |path: &Path| FlowFormat::from_path(path).is_some();
        match (text.parse::<HeadSource>(), text.parse::<DatasetSpec>()) {
            _ if path.exists() && SplatFormat::of(path).is_some() => Ok(Self::Splats(path.to_owned())),
            _ if path.exists() && is_flow(path) => Ok(Self::Flows(vec![path.to_owned()])),
            (Ok(head), _) => Ok(Self::Head(head)),
            (_, Ok(dataset)) => Ok(Self::Dataset(dataset)),
            _ => {
                let found = if path.exists() { "a file of another kind" } else { "no such file or folder" };
                wrong_settings!(
                    "{text}: expected a file of Gaussians ({}), a flow file ({}), a head such as builtin or avatar:DIR, a dataset \
                     such as srflow:DIR, or a folder; found {found}",
                    SplatFormat::extensions(),
                    FlowFormat::ALL.map(|format| format!(".{}", format.extension())).join(", "),
                )
            }
        }
    }

    fn in_folder(dir: &Path) -> anyhow::Result<Self> {
        let has = |name: &str| dir.join(name).is_file();
        let spec = |kind: &str| DatasetSpec { kind: kind.to_owned(), dir: dir.to_owned() };
        // The last of them is the folder of a training.
        if has("point_cloud.ply") || dir.join("point_cloud").is_dir() || has("run.json") {
            let text = format!("avatar:{}", dir.display());
            return Ok(Self::Head(text.parse().map_err(anyhow::Error::msg)?));
        }
        if has("dataset.json") {
            return Ok(Self::Dataset(spec("srflow")));
        }
        if has("scores.json") {
            return results(dir);
        }
        if FlowDataset::open(&spec("folder"), None).is_ok() {
            return Ok(Self::Dataset(spec("folder")));
        }
        let files = flow_files(dir)?;
        if !files.is_empty() {
            return Ok(Self::Flows(files));
        }
        bail!(
            "{}: expected the folder of an avatar (point_cloud.ply) or of its training (run.json), of a dataset of srflow (dataset.json), of results (scores.json) or \
             of flow files; found none of them. Name other datasets with their kind, such as sintel-clean:{}",
            dir.display(),
            dir.display()
        )
    }
}

/// The part of `scores.json` that says what was scored.
#[derive(Deserialize)]
struct Scored {
    dataset: String,
    folder: PathBuf,
    split: Split,
    limit: Option<usize>,
    made_by: Vec<MadeBy>,
}

#[derive(Deserialize)]
struct MadeBy {
    name: String,
}

/// The folder in which results keep the flow of each method.
const FLOW: &str = "flow";

fn results(dir: &Path) -> anyhow::Result<Thing> {
    let file = dir.join("scores.json");
    let text = read_text(&file, FileKind::Json)?;
    let scored: Scored = serde_json::from_str(&text).map_err(|error| {
        anyhow!(
            "{}: expected what `srflow eval --out` writes; {}",
            file.display(),
            parse_error_in_words(&error)
        )
    })?;
    let method = |method: &MadeBy| {
        let flow = dir.join(FLOW).join(folder_name(&method.name));
        ensure!(
            flow.is_dir(),
            "{}: no such folder; keep the flow of each method with `srflow eval --out {} --save-flow {}`",
            flow.display(),
            dir.display(),
            dir.join(FLOW).display()
        );
        Ok(MethodSpec {
            label: Some(method.name.clone()),
            weights: Some(flow.display().to_string()),
            ..Method::Files.into()
        })
    };
    Ok(Thing::Results {
        dataset: DatasetSpec { kind: scored.dataset, dir: scored.folder },
        split: scored.split,
        limit: scored.limit,
        methods: scored.made_by.iter().map(method).collect::<anyhow::Result<_>>()?,
    })
}

fn name_of(file: &Path) -> String {
    file.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

impl Pairs {
    fn len(&self) -> usize {
        match &self.kind {
            PairKind::Dataset(dataset, _) => dataset.entries().len(),
            PairKind::Flows(files) => files.len(),
        }
    }

    fn name(&self, number: usize) -> String {
        match &self.kind {
            PairKind::Dataset(dataset, _) => dataset.entries()[number].id(),
            PairKind::Flows(files) => name_of(&files[number]),
        }
    }

    fn pack(&self, number: usize) -> anyhow::Result<Pack> {
        match &self.kind {
            PairKind::Dataset(dataset, methods) => pair_pack(dataset, &dataset.entries()[number], methods),
            PairKind::Flows(files) => {
                let flow = read_flow(&files[number])?;
                Ok(ViewedPair { flow: Some(&flow), ..ViewedPair::default() }.pack()?)
            }
        }
    }

    fn main(&self, numbers: &[usize]) -> Pack {
        let about = match (numbers.len(), self.len()) {
            (shown, all) if shown < all => format!("{shown} of {all} pairs"),
            (1, _) => String::new(),
            (all, _) => format!("{all} pairs"),
        };
        let names: Vec<String> = numbers.iter().map(|&number| self.name(number)).collect();
        srflow_view::pairs(&self.title, &about, &names)
    }
}

fn pair_pack(dataset: &FlowDataset, entry: &Entry, methods: &[Source]) -> anyhow::Result<Pack> {
    let sample = dataset.read(entry)?;
    let depth = entry.read_depth()?;
    let flows = methods
        .iter()
        .map(|method| method.flow(&entry.id(), &sample.frame1, &sample.frame2))
        .collect::<anyhow::Result<Vec<_>>>()?;
    let epe = |flow: &FlowField, mask: Option<&Mask>| {
        let Some(truth) = &sample.flow else { return Ok(None) };
        anyhow::Ok(score(flow, truth, mask)?.map(|metrics| metrics.epe))
    };
    let viewed = methods.iter().zip(&flows).map(|(method, flow)| {
        let inside = match &sample.mask {
            Some(mask) => epe(flow, Some(mask))?,
            None => None,
        };
        Ok(ViewedFlow { name: method.method().name().to_owned(), flow, epe: [epe(flow, None)?, inside] })
    });
    let pair = ViewedPair {
        frames: Some([&sample.frame1, &sample.frame2]),
        flow: sample.flow.as_ref(),
        mask: sample.mask.as_ref(),
        occlusion: sample.occlusion.as_ref(),
        depth: depth.as_ref(),
        methods: viewed.collect::<anyhow::Result<_>>()?,
    };
    Ok(pair.pack()?)
}

impl Opened {
    /// The page with everything in it; of pairs at most `limit`.
    fn page(&self, limit: Option<usize>, watch: &Watch) -> anyhow::Result<Page> {
        match self {
            Self::Whole { title, main } => {
                let mut page = Page::new(title);
                page.embed("main", main);
                Ok(page)
            }
            Self::Pairs(pairs) => pairs_page(pairs, limit, watch),
        }
    }

    /// What a server sends under this name.
    fn answer(&self, name: &str, limit: Option<usize>) -> Answer {
        match (self, name) {
            (Self::Whole { title, .. } | Self::Pairs(Pairs { title, .. }), "") => {
                Answer::Page(Page::new(title).html())
            }
            (Self::Whole { main, .. }, "main") => Answer::Pack(main.gzipped()),
            (Self::Pairs(pairs), name) => {
                let numbers = spread(pairs.len(), limit);
                match name.parse().ok().and_then(|place: usize| numbers.get(place)) {
                    Some(&number) => match pairs.pack(number) {
                        Ok(pack) => Answer::Pack(pack.gzipped()),
                        Err(error) => Answer::Failed(in_words(&error)),
                    },
                    None if name == "main" => Answer::Pack(pairs.main(&numbers).gzipped()),
                    None => Answer::Failed(format!("there is no pair {name}")),
                }
            }
            _ => Answer::Failed(format!("there is no pack {name}")),
        }
    }
}

fn pairs_page(pairs: &Pairs, limit: Option<usize>, watch: &Watch) -> anyhow::Result<Page> {
    let first = pairs.pack(0)?;
    let usual = (USUAL_BYTES / first.gzipped().len()).clamp(1, USUAL_PAIRS);
    let numbers = spread(pairs.len(), Some(limit.unwrap_or(usual)));
    let packed = watch.count("pairs", numbers.len() as u64);
    let mut page = Page::new(&pairs.title);
    page.embed("main", &pairs.main(&numbers));
    for (place, &number) in numbers.iter().enumerate() {
        page.embed(place.to_string(), &pairs.pack(number)?);
        packed.inc();
    }
    Ok(page)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_is_named_after_its_thing() {
        for (thing, name) in [
            ("runs/avatar", "avatar.html"),
            ("avatar:runs/avatar/", "avatar.html"),
            ("scene.ply", "scene.html"),
            ("builtin", "builtin.html"),
            ("..", "view.html"),
        ] {
            assert_eq!(usual_name(thing), Path::new(name), "{thing}");
        }
    }
}
