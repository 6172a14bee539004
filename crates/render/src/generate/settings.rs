//! The settings of a dataset, checked before any work starts, and the plan derived from them.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use serde_json::Value;
use srflow_avatar::HeadSource;
use srflow_core::random::Key;
use srflow_core::{Numbers, Size, excerpt};
use srflow_files::FlowFormat;
use srflow_head::{Clip, Look};
use srflow_splat::Device;

use super::background::{self, Background};
use super::{FULL_SIZE, MotionSource, Rig};
use crate::clap::Args;
use crate::error::{check_size, require};
use crate::setting_files::{files_at, fingerprint};
use crate::{RenderError, head};
use srflow_data::manifest::{
    Arguments, LAYOUT_VERSION, MANIFEST_NAME, Manifest, Recording, SceneEntry, SceneSplit,
};

/// Maximum number of scenes, and of pairs in a scene: file names have a fixed number of digits.
const MAX_SCENES: u32 = 10_000;
const MAX_PAIRS: f64 = 99_999.0;

/// Minimum and maximum side of a frame, in pixels.
const SIDES: std::ops::RangeInclusive<usize> = 16..=16_384;

/// The settings of a dataset.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Settings {
    /// Head model
    #[arg(long, value_name = "HEAD", default_value_t = Self::default().head, help = head_help())]
    pub head: HeadSource,
    /// Version of how heads look; 1 keeps the bytes of earlier datasets
    #[arg(long, value_name = "1|2", default_value_t = Self::default().look)]
    #[serde(skip_serializing_if = "Look::is_unrecorded")]
    pub look: Look,
    /// Number of scenes, one subject each
    #[arg(long, value_name = "N", default_value_t = Self::default().scenes)]
    pub scenes: u32,
    /// Frame pairs per scene; a fraction is the mean over scenes of nearly equal length
    #[arg(long, value_name = "N", default_value_t = Self::default().frames)]
    pub frames: f64,
    /// Size of the frames, WIDTHxHEIGHT
    #[arg(long, value_name = "SIZE", default_value_t = Self::default().size)]
    pub size: Size,
    /// Shares of train, val and test scenes, which sum to 1
    #[arg(long, value_name = "SHARES", default_value_t = Self::default().splits)]
    pub splits: Numbers<f64, 3>,
    /// Random seed
    #[arg(long, value_name = "N", default_value_t = Self::default().seed)]
    pub seed: u64,
    /// File format of the flow
    #[arg(long, value_name = "FORMAT", default_value_t = Self::default().flow_format, help = flow_format_help())]
    pub flow_format: FlowFormat,
    /// Also write the flow from frame 2 to frame 1
    #[arg(long)]
    pub backward: bool,
    /// Also write the flow with the head moving alone, and what the expression adds to it
    #[arg(long)]
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub decompose: bool,
    /// Also write how much brighter or darker each surface becomes: the part of the change that is no motion
    #[arg(long)]
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub shading_change: bool,
    /// Also write depth
    #[arg(long)]
    pub depth: bool,
    /// Also write region maps: skin, eyes, mouth, hair or neck for each pixel
    #[arg(long)]
    pub regions: bool,
    /// Background: white, black, #rrggbb, `procedural` (rooms, textures, gradients, lights), or a folder of images
    #[arg(long, value_name = "COLOUR|DIR", default_value_t = Self::default().background)]
    pub background: Background,
    /// Motion: `curves` (random expressions, speech, blinks, gaze and turns), `mixed` (also
    /// micro-expressions, at many speeds), `own` (the avatar's training motion), or the flame_param.npz,
    /// capture or clip (FILE.glb@CLIP) of another subject with the same kind of head
    #[arg(long, value_name = "MOTION", default_value_t = Self::default().motion)]
    pub motion: MotionSource,
    /// Device to rasterize on
    #[arg(long, value_name = "DEVICE", default_value_t = Self::default().device)]
    pub device: Device,
    /// Imaging effects on the frames
    // Last: its heading holds for all that follow.
    #[command(flatten)]
    #[serde(flatten)]
    pub recording: Recording,
}

/// The help of a head's setting.
#[cfg(feature = "clap")]
pub(crate) fn head_help() -> String {
    format!("Head model: {}", HeadSource::help())
}

/// The help of a flow format's setting.
#[cfg(feature = "clap")]
pub(crate) fn flow_format_help() -> String {
    format!("File format of the flow: {}", FlowFormat::ALL.map(FlowFormat::extension).join(", "))
}

impl Default for Settings {
    /// The paper's dataset: 11,161 pairs of 27 scenes at 2200x3208.
    fn default() -> Self {
        Self {
            head: HeadSource::builtin(),
            look: Look::default(),
            scenes: 27,
            frames: 413.37,
            size: FULL_SIZE,
            splits: Numbers([0.61, 0.11, 0.28]),
            seed: 1,
            flow_format: FlowFormat::Npz16,
            backward: false,
            decompose: false,
            shading_change: false,
            depth: false,
            background: Background::Colour([255; 3]),
            motion: MotionSource::Curves,
            regions: false,
            recording: Recording::none(),
            device: Device::cpu(),
        }
    }
}

impl Settings {
    /// The preset `wild`: frames that look like recordings, with procedural backgrounds, and small and large motion; else the
    /// defaults.
    pub fn wild() -> Self {
        Self {
            background: Background::Procedural,
            motion: MotionSource::Mixed,
            recording: Recording::wild(),
            ..Self::default()
        }
    }

    /// The head with its look.
    pub(crate) fn dressed_head(&self) -> HeadSource {
        self.head.with_look(self.look)
    }

    /// Checks the settings and plans the dataset.
    ///
    /// # Errors
    /// When a setting is out of range or one of its folders cannot be read.
    pub(crate) fn plan(&self) -> Result<Manifest, RenderError> {
        self.validate()?;
        let backgrounds = background::choose(&self.background, self.scenes as usize, self.seed)?;
        Ok(self.lay_out(self.arguments()?, backgrounds))
    }

    /// The plan for valid settings.
    fn lay_out(&self, arguments: Arguments, backgrounds: Vec<Option<String>>) -> Manifest {
        let splits = assign_splits(self.scenes as usize, *self.splits, self.seed);
        let entry = |(number, (split, background)): (u32, (SceneSplit, Option<String>))| {
            let pairs = self.pairs_before(number + 1) - self.pairs_before(number);
            self.entry(number, split, pairs, background)
        };
        Manifest {
            layout_version: LAYOUT_VERSION,
            srflow_version: env!("CARGO_PKG_VERSION").to_owned(),
            arguments,
            rig: self.rig().cameras(),
            scenes: (0..).zip(splits.into_iter().zip(backgrounds)).map(entry).collect(),
        }
    }

    /// Scene `number`, which does not depend on the number of scenes.
    pub(super) fn entry(
        &self,
        number: u32,
        split: SceneSplit,
        pairs: u32,
        background: Option<String>,
    ) -> SceneEntry {
        let subject = u64::from(Key::new(self.seed).scene(number).stream("subject").bits());
        SceneEntry { name: format!("scene-{number:04}"), split, subject, pairs, background }
    }

    /// The settings of an existing dataset, except for the folders of the head and the backgrounds and the device; and the manifest that they
    /// give, with the background images named in `manifest`.
    ///
    /// # Errors
    /// Names the arguments of the manifest that `srflow render` would not accept.
    pub(crate) fn of(manifest: &Manifest) -> Result<(Self, Manifest), String> {
        let arguments = &manifest.arguments;
        let settings = arguments.settings().map_err(|error| error.to_string())?;
        let mut settings = with_flat_recording(settings)?;
        head::name_look(&mut settings);
        // What is in files is known by its fingerprint alone, and a device may be one that this build lacks.
        let mut text = |field: &str| settings.as_object_mut().and_then(|settings| settings.remove(field));
        let [head, background, motion, _] = ["head", "background", "motion", "device"].map(&mut text);
        let mut settings: Self = serde_json::from_value(settings).map_err(|error| error.to_string())?;
        let wrong = |field: &str, found: &str| format!("{field} `{}`: unknown kind", excerpt(found));
        if let Some(head) = head.as_ref().and_then(Value::as_str) {
            let (kind, has_files) = split_fingerprint(head);
            settings.head = HeadSource::of_kind(kind)
                .filter(|source| source.is_builtin() != has_files)
                .ok_or_else(|| wrong("head", head))?;
        }
        if let Some(background) = background.as_ref().and_then(Value::as_str) {
            settings.background = match (split_fingerprint(background), background.parse()) {
                (("images", true), _) => Background::Images(PathBuf::new()),
                (_, Ok(made @ (Background::Colour(_) | Background::Procedural))) => made,
                _ => return Err(wrong("background", background)),
            };
        }
        if let Some(motion) = motion.as_ref().and_then(Value::as_str) {
            let Ok(parsed) = motion.parse();
            settings.motion = match (split_fingerprint(motion), parsed) {
                ((kind, true), _) if kind.split('@').next() == Some("recorded") => {
                    MotionSource::Recorded(PathBuf::new())
                }
                (_, MotionSource::Recorded(_)) => return Err(wrong("motion", motion)),
                (_, made) => made,
            };
        }
        settings.validate().map_err(|error| error.to_string())?;
        let images = matches!(settings.background, Background::Images(_));
        let named = manifest.scenes.iter().map(|scene| scene.background.clone());
        let missing = || images.then(|| "an image".to_owned());
        let backgrounds = named.map(|name| if images { name.or_else(missing) } else { None });
        let backgrounds = backgrounds.chain(std::iter::repeat_with(missing)).take(settings.scenes as usize);
        let planned = settings.lay_out(arguments.clone(), backgrounds.collect());
        Ok((settings, planned))
    }

    /// A note for each split that has a share but, for lack of scenes, gets none.
    pub fn empty_splits(&self) -> Vec<String> {
        if self.validate().is_err() {
            return Vec::new();
        }
        let counts = |scenes: u32| largest_remainder(scenes as usize, *self.splits);
        let lacks = |scenes: u32, part: usize| self.splits[part] > 0.0 && counts(scenes)[part] == 0;
        let empty = (0..3).filter(|&part| lacks(self.scenes, part));
        let enough = (self.scenes..=MAX_SCENES).find(|&scenes| (0..3).all(|part| !lacks(scenes, part)));
        let advice = enough.map_or("give it a larger share with `splits`".to_owned(), |scenes| {
            format!("`scenes` {scenes} gives each split at least one, or change `splits`")
        });
        let note = |part: usize| {
            let (split, share) = (SceneSplit::ALL[part], self.splits[part]);
            format!(
                "the {split} split is empty: a share of {share} of {} scenes rounds to none; {advice}",
                self.scenes
            )
        };
        empty.map(note).collect()
    }

    /// The rig, independent of the subject.
    pub(crate) fn rig(&self) -> Rig {
        Rig::new(self.size, head::centre(&self.head))
    }

    /// Number of pairs in the scenes before scene `number`: every scene has the mean, rounded down or up.
    fn pairs_before(&self, number: u32) -> u32 {
        let total = (f64::from(self.scenes) * self.frames).round() as u64;
        (u64::from(number) * total / u64::from(self.scenes)) as u32
    }

    fn validate(&self) -> Result<(), RenderError> {
        let scenes = (1..=MAX_SCENES).contains(&self.scenes);
        require("scenes", self.scenes, format!("1 to {MAX_SCENES}"), scenes)?;
        let frames = (1.0..=MAX_PAIRS).contains(&self.frames);
        require("frames", self.frames, format!("1 to {MAX_PAIRS}"), frames)?;
        check_size(self.size, SIDES)?;
        let sum: f64 = self.splits.iter().sum();
        let fine = self.splits.iter().all(|share| (0.0..=1.0).contains(share)) && (sum - 1.0).abs() <= 1e-6;
        let expected = format!("three shares from 0 to 1 that sum to 1, not {sum:.6}");
        require("splits", self.splits, expected, fine)?;
        let Recording { noise, lighting, lamps, shutter, defocus, jpeg } = self.recording;
        for (field, value, most, unit) in [
            ("recording.noise", noise, 50.0, ""),
            ("recording.lighting", lighting, 4.0, ""),
            ("recording.lamps", lamps, 1.0, ""),
            ("recording.shutter", shutter, 1.0, ""),
            ("recording.defocus", defocus, 64.0, " pixels"),
        ] {
            require(field, value, format!("0 to {most}{unit}"), (0.0..=most).contains(&value))?;
        }
        if let Some(quality) = jpeg {
            require("recording.jpeg", quality, "1 to 100", (1..=100).contains(&quality))?;
        }
        Ok(())
    }

    /// The settings as `dataset.json` holds them: all that determine the bytes, with fingerprints in place of folders. What is off
    /// by default is left out where it is off, as in datasets of before there was such a setting.
    fn arguments(&self) -> Result<Arguments, RenderError> {
        let unwritable = |error: serde_json::Error| RenderError::Malformed {
            path: MANIFEST_NAME.into(),
            reason: error.to_string(),
        };
        // By way of text, where 0.8 stays 0.8: as a value, a float of 32 bits becomes one of 64 with all its digits.
        let text = serde_json::to_string(self).map_err(unwritable)?;
        let mut settings = with_nested_recording(serde_json::from_str(&text).map_err(unwritable)?);
        settings["head"] = head::recorded(&self.head)?.into();
        if let Background::Images(dir) = &self.background {
            settings["background"] = format!("images, {}", fingerprint(&background::images(dir)?)).into();
        }
        if let MotionSource::Recorded(path) = &self.motion {
            let clip = Clip::parse(path);
            let file = clip.as_ref().map_or(path.as_path(), Clip::file);
            let fingerprint = fingerprint(&files_at(file, "motion", "a file or folder that can be read")?);
            let name = clip.as_ref().and_then(Clip::name).map(|name| format!("@{name}"));
            settings["motion"] = format!("recorded{}, {fingerprint}", name.unwrap_or_default()).into();
        }
        settings["device"] = self.device.kind().into();
        let off = [
            ("motion", self.motion == MotionSource::Curves),
            ("device", self.device.is_cpu()),
            (RECORDING, self.recording.is_none()),
        ];
        if let Some(settings) = settings.as_object_mut() {
            settings.retain(|name, _| !off.contains(&(name, true)));
        }
        Arguments::of_settings(settings, self.size).map_err(unwritable)
    }
}

/// The settings of imaging effects in files, where they are a group.
const RECORDING: &str = "recording";

/// Moves imaging effects into their group.
fn with_nested_recording(mut settings: Value) -> Value {
    let Value::Object(all) = &mut settings else { return settings };
    let Value::Object(effects) = serde_json::json!(Recording::wild()) else { return settings };
    let group = effects.keys().filter_map(|name| all.remove_entry(name)).collect();
    all.insert(RECORDING.to_owned(), Value::Object(group));
    settings
}

/// Moves imaging effects out of their group.
///
/// # Errors
/// When the group has something else in it.
pub fn with_flat_recording(mut settings: Value) -> Result<Value, String> {
    if let Some(all) = settings.as_object_mut()
        && let Some(group) = all.remove(RECORDING)
    {
        let recording: Recording =
            serde_json::from_value(group).map_err(|error| format!("{RECORDING}: {error}"))?;
        if let Value::Object(effects) = serde_json::json!(recording) {
            all.extend(effects);
        }
    }
    Ok(settings)
}

/// The kind of what `dataset.json` records, and whether a fingerprint of its files follows.
fn split_fingerprint(recorded: &str) -> (&str, bool) {
    recorded.split_once(", ").map_or((recorded, false), |(kind, _)| (kind, true))
}

/// The split of each scene: counts by largest remainder, scenes drawn at random.
fn assign_splits(scenes: usize, shares: [f64; 3], seed: u64) -> Vec<SceneSplit> {
    let counts = largest_remainder(scenes, shares);
    let mut assigned: Vec<SceneSplit> = SceneSplit::ALL
        .into_iter()
        .zip(counts)
        .flat_map(|(split, n)| std::iter::repeat_n(split, n))
        .collect();
    let mut stream = Key::new(seed).stream("splits");
    stream.shuffle(&mut assigned);
    assigned
}

/// Distributes `total` items: each share rounded down, and the rest to the largest remainders.
fn largest_remainder(total: usize, shares: [f64; 3]) -> [usize; 3] {
    let exact = shares.map(|share| share * total as f64);
    let mut counts = exact.map(|x| x as usize);
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| exact[b].fract().total_cmp(&exact[a].fract()).then(a.cmp(&b)));
    let left = total - counts.iter().sum::<usize>().min(total);
    for &part in order.iter().cycle().take(left) {
        counts[part] += 1;
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(settings: &Settings) -> Result<Manifest, String> {
        settings.plan().map_err(|error| error.to_string())
    }

    #[test]
    fn the_defaults_are_the_papers_table() {
        let manifest = plan(&Settings::default()).unwrap();
        assert_eq!((manifest.scenes.len(), manifest.pairs()), (27, 11_161));
        assert!(manifest.scenes.iter().all(|scene| scene.pairs == 413 || scene.pairs == 414));
        let count = |split| manifest.scenes_of(split).count();
        assert_eq!(SceneSplit::ALL.map(count), [16, 3, 8]);
    }

    #[test]
    fn a_scene_does_not_depend_on_the_number_of_scenes() {
        let few = plan(&Settings { scenes: 3, frames: 5.0, ..Settings::default() }).unwrap();
        let many = plan(&Settings::default()).unwrap();
        for (a, b) in few.scenes.iter().zip(&many.scenes) {
            assert_eq!((&a.name, a.subject, a.pairs), (&b.name, b.subject, 5));
        }
        let mut subjects: Vec<u64> = many.scenes.iter().map(|scene| scene.subject).collect();
        subjects.sort_unstable();
        subjects.dedup();
        assert_eq!(subjects.len(), 27);
    }

    #[test]
    fn shares_become_whole_numbers_that_sum() {
        assert_eq!(largest_remainder(3, [0.61, 0.11, 0.28]), [2, 0, 1]);
        assert_eq!(largest_remainder(1, [0.0, 0.0, 1.0]), [0, 0, 1]);
        assert_eq!(largest_remainder(7, [1.0, 0.0, 0.0]), [7, 0, 0]);
        for total in 0..200 {
            assert_eq!(
                largest_remainder(total, [0.3333333, 0.3333333, 0.3333334]).iter().sum::<usize>(),
                total
            );
        }
    }

    #[test]
    fn splits_that_get_no_scene_are_named() {
        let notes = Settings { scenes: 3, ..Settings::default() }.empty_splits();
        assert!(notes.len() == 1 && notes[0].contains("the val split is empty"), "{notes:?}");
        let enough = notes[0].split("`scenes` ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
        assert!(Settings { scenes: enough, ..Settings::default() }.empty_splits().is_empty());
        assert!(!Settings { scenes: enough - 1, ..Settings::default() }.empty_splits().is_empty());
        let wanted = Settings { scenes: 1, splits: Numbers([1.0, 0.0, 0.0]), ..Settings::default() };
        assert!(wanted.empty_splits().is_empty(), "a share of zero is intended");
    }

    #[test]
    fn the_arguments_of_a_dataset_are_those_that_it_always_had() {
        let first = Settings { look: Look::First, scenes: 2, frames: 3.0, ..Settings::wild() };
        let manifest = plan(&first).unwrap();
        let mut arguments: Value =
            serde_json::from_str(&serde_json::to_string(&manifest.arguments).unwrap()).unwrap();
        let recording = serde_json::json!({
            "noise": 2.0, "lighting": 1.0, "lamps": 0.8, "shutter": 0.8, "defocus": 1.5, "jpeg": 40
        });
        assert_eq!(arguments["recording"].take(), recording);
        arguments.as_object_mut().unwrap().remove("recording");
        let expected = serde_json::json!({
            "head": "builtin", "scenes": 2, "frames": 3.0, "width": 2200, "height": 3208, "splits": [0.61, 0.11, 0.28],
            "seed": 1, "flow_format": "npz16", "backward": false, "depth": false, "background": "procedural", "motion": "mixed"
        });
        assert_eq!(arguments, expected);
        let (settings, planned) = Settings::of(&manifest).unwrap();
        assert_eq!((settings, planned), (first.clone(), manifest));
        let manifest = plan(&Settings { look: Look::Second, ..first }).unwrap();
        assert!(serde_json::to_string(&manifest.arguments).unwrap().contains(r#""look":2"#));
        assert_eq!(Settings::of(&manifest).unwrap().0.look, Look::Second);
    }

    #[test]
    fn errors_come_before_any_work() {
        let base = Settings::default;
        let size = |width, height| Settings { size: Size { width, height }, ..base() };
        let splits = |shares| Settings { splits: Numbers(shares), ..base() };
        let recorded = |recording| Settings { recording, ..base() };
        let none = Recording::none;
        for (settings, message) in [
            (Settings { scenes: 0, ..base() }, "scenes 0: expected 1 to 10000"),
            (Settings { frames: 0.0, ..base() }, "frames 0"),
            (Settings { frames: f64::NAN, ..base() }, "frames NaN"),
            (size(0, 3208), "size 0x3208"),
            (size(2200, 1 << 40), "to 16384x16384"),
            (splits([0.5, 0.1, 0.1]), "sum to 1, not 0.7"),
            (splits([1.5, -0.5, 0.0]), "from 0 to 1"),
            (
                Settings { background: Background::Images("/nowhere".into()), ..base() },
                "background` /nowhere",
            ),
            (Settings { head: "ict:/nowhere".parse().unwrap(), ..base() }, "head` /nowhere"),
            (recorded(Recording { noise: f32::NAN, ..none() }), "recording.noise NaN"),
            (recorded(Recording { lighting: -1.0, ..none() }), "recording.lighting -1"),
            (recorded(Recording { lamps: 2.0, ..none() }), "recording.lamps 2"),
            (recorded(Recording { shutter: 1.1, ..none() }), "recording.shutter 1.1"),
            (recorded(Recording { defocus: 65.0, ..none() }), "recording.defocus 65"),
            (recorded(Recording { jpeg: Some(0), ..none() }), "recording.jpeg 0"),
        ] {
            let error = plan(&settings).unwrap_err();
            assert!(error.contains(message), "{error}");
        }
    }
}
