//! Pairs of a dataset, or flow alone.

use serde_json::{Value, json};
use srflow_core::{FlowField, Image, Mask, Plane, Size};

use crate::pack::Pack;
use crate::splats::ViewError;

/// What is known of a pair of frames; all of one size.
#[derive(Debug, Default)]
pub struct ViewedPair<'a> {
    pub frames: Option<[&'a Image; 2]>,
    /// The true flow, or the only one.
    pub flow: Option<&'a FlowField>,
    pub mask: Option<&'a Mask>,
    pub occlusion: Option<&'a Mask>,
    /// Metres; 0 where there is none.
    pub depth: Option<&'a Plane>,
    pub methods: Vec<ViewedFlow<'a>>,
}

/// The flow of a method.
#[derive(Debug)]
pub struct ViewedFlow<'a> {
    pub name: String,
    pub flow: &'a FlowField,
    /// End-point error in pixels, if the truth is known: over all pixels, and inside the head's mask.
    pub epe: [Option<f64>; 2],
}

/// A page of pairs, whose packs are named by their numbers from 0.
pub fn pairs(title: &str, about: &str, names: &[String]) -> Pack {
    Pack::new(json!({ "page": "pairs", "title": title, "about": about, "pairs": names }))
}

impl ViewedPair<'_> {
    /// The pack of this pair; flow is rounded to half precision.
    ///
    /// # Errors
    /// When a frame is too large for PNG.
    pub fn pack(&self) -> Result<Pack, ViewError> {
        let methods = self.methods.iter().enumerate().map(|(number, method)| {
            let [epe, epe_head] = method.epe;
            json!({ "key": key(number), "name": method.name, "epe": epe, "epe_head": epe_head })
        });
        let Size { width, height } = self.size();
        let mut pack = Pack::new(
            json!({ "width": width, "height": height, "methods": methods.collect::<Vec<Value>>() }),
        );
        for (number, frame) in (1..).zip(self.frames.into_iter().flatten()) {
            pack.add(format!("frame{number}"), &png(frame)?);
        }
        let flows = self.flow.map(|flow| ("flow".to_owned(), flow)).into_iter();
        for (name, flow) in flows.chain((0..).zip(&self.methods).map(|(i, method)| (key(i), method.flow))) {
            pack.add_halves(name, flow.pixels().as_flattened().iter().copied());
        }
        for (name, mask) in [("mask", self.mask), ("occlusion", self.occlusion)] {
            if let Some(mask) = mask {
                pack.add(name, &mask.pixels().iter().map(|&inside| u8::from(inside)).collect::<Vec<u8>>());
            }
        }
        if let Some(depth) = self.depth {
            pack.add_halves("depth", depth.pixels().iter().copied());
        }
        Ok(pack)
    }

    fn size(&self) -> Size {
        let frame = self.frames.map(|[frame, _]| frame.size());
        let flow = self.flow.or_else(|| Some(self.methods.first()?.flow)).map(|flow| flow.size());
        frame.or(flow).unwrap_or_default()
    }
}

fn key(method: usize) -> String {
    format!("method{method}")
}

fn png(image: &Image) -> Result<Vec<u8>, ViewError> {
    let size = image.size();
    let wrong = |reason: String| ViewError::Frame { size, reason };
    let side = |pixels: usize| u32::try_from(pixels).map_err(|error| wrong(error.to_string()));
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, side(size.width)?, side(size.height)?);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().map_err(|error| wrong(error.to_string()))?;
    writer.write_image_data(image.pixels().as_flattened()).map_err(|error| wrong(error.to_string()))?;
    writer.finish().map_err(|error| wrong(error.to_string()))?;
    Ok(bytes)
}
