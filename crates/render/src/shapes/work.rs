//! Making pairs, from the layers to the files.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use srflow_core::random::{Key, Stream};
use srflow_core::resize::resize_image_antialiased;
use srflow_core::{Image, Size, Spares};
use srflow_data::flow::{MadeError, MadePairs, Sample};
use srflow_files::{FlowFormat, read_image, write_flow_as, write_image_png, write_mask_png};

use super::settings::MAX_PAIRS;
use super::texture::Texture;
use super::{ShapePair, ShapesSettings};
use crate::RenderError;
use crate::error::require;
use crate::job::{Layout, Plan, Run, Stage, leading_number, names_in, remove};
use crate::record::{json_text, read_record};
use crate::setting_files::{fingerprint, images_in};

const SETTINGS_NAME: &str = "shapes.json";
const DATA: &str = "data";
pub const SPLIT_NAME: &str = "FlyingChairs_train_val.txt";

/// The files of a pair, after its number.
const PICTURES: [&str; 3] = ["_img1.png", "_img2.png", "_occlusion.png"];

/// Share of the layers that show a photograph, if there are any.
const PHOTOGRAPHS: f32 = 0.5;

/// Photographs that a worker keeps, and the side to which larger ones are reduced.
const KEPT: usize = 32;
const LARGEST_SIDE: usize = 1024;

/// The contents of `shapes.json`.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Arguments {
    srflow_version: String,
    pairs: u32,
    width: usize,
    height: usize,
    seed: u64,
    motion: [f32; 2],
    /// `made`, or the number and the fingerprint of the photographs.
    textures: String,
    flow_format: FlowFormat,
}

impl Arguments {
    /// Of the dataset in a folder.
    pub fn read(dir: &Path) -> Result<Self, RenderError> {
        let path = dir.join(SETTINGS_NAME);
        let arguments: Self = read_record(&path)?;
        if arguments.pairs > MAX_PAIRS {
            let reason = format!("{} pairs where there are at most {MAX_PAIRS}", arguments.pairs);
            return Err(RenderError::Malformed { path, reason });
        }
        Ok(arguments)
    }

    pub fn pairs(&self) -> u32 {
        self.pairs
    }

    fn flow_path(&self, dir: &Path, pair: u32) -> PathBuf {
        dir.join(DATA).join(format!("{:05}_flow.{}", pair + 1, self.flow_format.extension()))
    }
}

/// The files of a pair besides its flow.
fn pictures(dir: &Path, pair: u32) -> [PathBuf; 3] {
    PICTURES.map(|suffix| dir.join(DATA).join(format!("{:05}{suffix}", pair + 1)))
}

impl Layout for Arguments {
    const MANIFEST: &'static str = SETTINGS_NAME;
    const UNITS: &'static str = "pairs";

    fn groups(&self) -> Vec<u32> {
        vec![self.pairs]
    }

    fn files(&self, dir: &Path, _group: u32, pair: u32) -> Vec<PathBuf> {
        std::iter::once(self.flow_path(dir, pair)).chain(pictures(dir, pair)).collect()
    }

    fn begun_in(&self, dir: &Path) -> Vec<(u32, u32)> {
        let flow = |name: &OsString| name.to_str().is_some_and(|name| name.contains("_flow."));
        let numbers =
            names_in(&dir.join(DATA)).filter(flow).filter_map(|name| leading_number(&name)?.checked_sub(1));
        numbers.filter(|pair| *pair < self.pairs).map(|pair| (0, pair)).collect()
    }

    fn name(&self, _group: u32, pair: u32) -> String {
        format!("pair {:05}", pair + 1)
    }

    fn others(&self) -> Vec<PathBuf> {
        vec![SPLIT_NAME.into()]
    }
}

type Work<'w> = crate::job::Work<'w, ShapePairs>;

/// The pairs of a dataset of generic pairs, one group of a plan. As [`MadePairs`], without end, each is a scene of its own.
pub struct ShapePairs {
    settings: ShapesSettings,
    arguments: Arguments,
    /// Photographs by name.
    photographs: Vec<PathBuf>,
    /// One for each thread that has made pairs in memory.
    read: Spares<Photographs>,
}

impl ShapePairs {
    /// # Errors
    /// When a setting is out of range, or the folder of textures cannot be read or has no images.
    pub fn new(settings: ShapesSettings) -> Result<Self, RenderError> {
        settings.validate()?;
        let (photographs, textures) = match &settings.textures {
            None => (Vec::new(), "made".to_owned()),
            Some(dir) => {
                let files = images_in(dir, "textures", "a folder of images")?;
                (files.iter().map(|(name, _)| dir.join(name)).collect(), fingerprint(&files))
            }
        };
        let ShapesSettings { pairs, size, seed, motion, flow_format, .. } = settings;
        let arguments = Arguments {
            srflow_version: env!("CARGO_PKG_VERSION").to_owned(),
            pairs,
            width: size.width,
            height: size.height,
            seed,
            motion: *motion,
            textures,
            flow_format,
        };
        Ok(Self { settings, arguments, photographs, read: Spares::default() })
    }

    /// Pair `number`, from 0.
    fn pair(&self, number: u32, photographs: &mut Photographs) -> Result<ShapePair, RenderError> {
        let ShapesSettings { size, seed, motion, .. } = self.settings;
        let mut unread = None;
        let mut photograph = |stream: &mut Stream| {
            photographs.draw(&self.photographs, stream).unwrap_or_else(|error| {
                unread.get_or_insert(error);
                None
            })
        };
        let key = Key::new(seed).scene(number);
        let pair = ShapePair::random(size, key, *motion, &mut photograph);
        unread.map_or(Ok(pair), Err)
    }
}

impl Plan for ShapePairs {
    type Layout = Arguments;
    type Group = ();
    type Worker = Photographs;

    const LONGEST_RUN: u32 = 16;

    fn layout(&self) -> &Arguments {
        &self.arguments
    }

    fn manifest(&self) -> String {
        json_text(&self.arguments)
    }

    fn folders(&self, dir: &Path, _run: &Run) -> Vec<PathBuf> {
        vec![dir.join(DATA)]
    }

    fn makes(&self, run: &Run, _folder: &Path, name: &str) -> bool {
        let number: Option<u32> = name.split('_').next().and_then(|digits| digits.parse().ok());
        number.and_then(|number| number.checked_sub(1)).is_some_and(|pair| run.units.contains(&pair))
    }

    fn delete(&self, dir: &Path, found: &str) -> Result<(), RenderError> {
        // If the settings cannot be read, the dataset's files are unknown: they are overwritten instead.
        let Ok(other) = serde_json::from_str::<Arguments>(found) else { return Ok(()) };
        remove(&dir.join(SPLIT_NAME))?;
        for file in (0..other.pairs).flat_map(|pair| other.files(dir, 0, pair)) {
            remove(&file)?;
        }
        Ok(())
    }

    fn group(&self, _number: u32) -> Result<(), RenderError> {
        Ok(())
    }

    fn worker(&self) -> Photographs {
        Photographs::default()
    }

    fn make(
        &self,
        work: &Work<'_>,
        _group: &(),
        run: &Run,
        photographs: &mut Photographs,
    ) -> Result<(), RenderError> {
        work.each(run.units.clone(), |number| {
            let pair = work.clock.time(Stage::Rasterize, || self.pair(number, photographs))?;
            let [frame1, frame2, occlusion] = pictures(work.dir, number);
            work.write(Stage::Frames, &frame1, |path| write_image_png(path, &pair.frame1))?;
            work.write(Stage::Frames, &frame2, |path| write_image_png(path, &pair.frame2))?;
            work.write(Stage::Planes, &occlusion, |path| write_mask_png(path, &pair.occlusion))?;
            let flow_format = self.settings.flow_format;
            let flow = self.arguments.flow_path(work.dir, number);
            work.write(Stage::Flow, &flow, |path| write_flow_as(path, &pair.flow, flow_format))
        })
    }
}

impl MadePairs for ShapePairs {
    fn pairs_per_scene(&self) -> u32 {
        1
    }

    fn name(&self, scene: u32, _pair: u32) -> String {
        format!("pair {} of seed {}", u64::from(scene) + 1, self.settings.seed)
    }

    fn make(&self, scene: u32, run: Range<u32>) -> Result<Vec<Sample>, MadeError> {
        let mut photographs = self.read.take().unwrap_or_default();
        let samples = run.map(|_| Ok(self.pair(scene, &mut photographs)?.into()));
        let samples = samples.collect::<Result<_, RenderError>>()?;
        self.read.put(photographs);
        Ok(samples)
    }
}

/// The photographs that one worker has read, by their numbers.
#[derive(Default)]
pub struct Photographs(BTreeMap<usize, Image>);

impl Photographs {
    /// A random one of `paths` as a texture, or none.
    fn draw(&mut self, paths: &[PathBuf], stream: &mut Stream) -> Result<Option<Texture>, RenderError> {
        if paths.is_empty() || stream.unit() >= PHOTOGRAPHS {
            return Ok(None);
        }
        let number = stream.below(paths.len() as u32) as usize;
        if !self.0.contains_key(&number) {
            let image = reduced(read_image(&paths[number])?);
            let expected = "images with at least one pixel";
            require("textures", paths[number].display(), expected, !image.pixels().is_empty())?;
            if self.0.len() == KEPT {
                self.0.pop_first();
            }
            self.0.insert(number, image);
        }
        Ok(Some(Texture::photograph(&self.0[&number], stream)))
    }
}

/// The image, smaller if it is larger than [`LARGEST_SIDE`].
fn reduced(image: Image) -> Image {
    let Size { width, height } = image.size();
    let side = width.max(height);
    if side <= LARGEST_SIDE {
        return image;
    }
    let scaled = |length: usize| (length * LARGEST_SIDE / side).max(1);
    resize_image_antialiased(&image, Size::new(scaled(width), scaled(height)))
}
