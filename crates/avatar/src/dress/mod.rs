//! Dressing a head model with Gaussians: skin, eyes, mouth, brows, lashes and hair.

#![allow(dead_code)]

mod appearance;
mod light;
mod noise;
mod occlusion;
mod skin;
mod surface;

use srflow_field::random::{Key, Stream};

use crate::binding::{BoundGaussians, Splat};
use crate::{HeadModel, ShapedHead};
use appearance::Appearance;
use light::Exposure;
use surface::{Surface, SurfacePoint};

/// Dresses the head of `shaped` as the person of `seed`. The model is valid and has 68 landmarks.
pub(crate) fn dress(model: &HeadModel, shaped: &ShapedHead, seed: u64) -> BoundGaussians {
    let surface = Surface::new(model, shaped);
    let mut dressing = Dressing {
        surface: &surface,
        appearance: Appearance::of(seed),
        exposures: light::bake(&surface),
        seed,
        bound: BoundGaussians::default(),
    };
    skin::dress_skin(&mut dressing);
    dressing.bound
}

/// A head while it is being dressed.
struct Dressing<'a> {
    surface: &'a Surface<'a>,
    appearance: Appearance,
    exposures: Vec<Exposure>,
    seed: u64,
    bound: BoundGaussians,
}

impl Dressing<'_> {
    fn stream(&self, purpose: &str) -> Stream {
        Key::new(self.seed).stream(purpose)
    }

    fn exposure(&self, point: &SurfacePoint) -> Exposure {
        self.surface.value(&self.exposures, point)
    }

    fn add(&mut self, triangle: u32, splat: Splat) {
        self.bound.bind(triangle, &self.surface.frames[triangle as usize], &splat);
    }
}
