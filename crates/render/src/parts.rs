//! Recognizes the part of the head that each pixel shows: the one whose Gaussians have the largest weight in it.

use srflow_avatar::Avatar;
use srflow_core::Plane;
use srflow_data::region_map::HeadPart;
use srflow_head::Region;
use srflow_splat::{Camera, DeviceRasterizer, Frame, Gaussians, Options, Outputs, RasterizeError, SH_0};

/// Parts are rendered in the three channels of a colour, this many times. Skin has none: its weight is what the others leave of
/// alpha.
const PASSES: usize = (HeadPart::ALL.len() - 1).div_ceil(3);

/// The part that a region of the mesh belongs to.
pub(crate) fn part_of(region: Region) -> HeadPart {
    match region {
        Region::Skin | Region::Lips | Region::Brow | Region::LidMargin => HeadPart::Skin,
        Region::Eyeball | Region::InnerLid | Region::Clear => HeadPart::Eyes,
        Region::Teeth | Region::MouthInside => HeadPart::Mouth,
        Region::Scalp => HeadPart::Hair,
        Region::Neck => HeadPart::Neck,
    }
}

/// The weights of the parts in every pixel of a rendering. Keeps its buffers.
#[derive(Debug, Default)]
pub(crate) struct PartWeights {
    /// The colours of each pass.
    passes: [Frame; PASSES],
    /// Those of the Gaussians in a pass.
    painted: Vec<[f32; 3]>,
}

impl PartWeights {
    /// Renders the Gaussians of `avatar`, which are posed, in the colours that stand for their parts. They get their own back.
    ///
    /// # Errors
    /// When the Gaussians or the camera are refused.
    pub fn render(
        &mut self,
        rasterizer: &mut DeviceRasterizer,
        avatar: &Avatar,
        gaussians: &mut Gaussians,
        camera: &Camera,
    ) -> Result<(), RasterizeError> {
        let options = Options { outputs: Outputs { color: true, ..Outputs::NONE }, ..Options::default() };
        let own =
            (gaussians.sh_degree, std::mem::replace(&mut gaussians.sh, std::mem::take(&mut self.painted)));
        let rendered = self.passes.iter_mut().enumerate().try_for_each(|(pass, frame)| {
            paint_parts(avatar, pass, gaussians);
            rasterizer.render(gaussians, camera, None, &options, frame)
        });
        gaussians.sh_degree = own.0;
        self.painted = std::mem::replace(&mut gaussians.sh, own.1);
        rendered
    }

    /// The part at each pixel of the mask, row-major; `None` where `alpha`, which the same Gaussians gave, is not above one half.
    pub fn parts<'a>(&'a self, alpha: &'a Plane) -> impl Iterator<Item = Option<HeadPart>> + 'a {
        alpha.pixels().iter().enumerate().map(|(pixel, &alpha)| {
            let colors = self.passes.each_ref().map(|frame| frame.color[pixel]);
            (alpha > 0.5).then(|| largest(colors, alpha))
        })
    }
}

/// Colours the Gaussians by the part that they belong to.
fn paint_parts(avatar: &Avatar, pass: usize, gaussians: &mut Gaussians) {
    let regions = &avatar.model().regions;
    let colour = |&triangle: &u32| {
        paint(part_of(regions[triangle as usize]), pass).map(|channel| (channel - 0.5) / SH_0 as f32)
    };
    gaussians.sh_degree = 0;
    gaussians.sh.clear();
    gaussians.sh.extend(avatar.bound().triangles().iter().map(colour));
}

/// The colour that stands for a part in a pass.
fn paint(part: HeadPart, pass: usize) -> [f32; 3] {
    std::array::from_fn(|channel| if part as usize == 1 + 3 * pass + channel { 1.0 } else { 0.0 })
}

/// The part with the largest weight, from the colours of all passes.
fn largest(colors: [[f32; 3]; PASSES], alpha: f32) -> HeadPart {
    let weights = colors.as_flattened();
    let mut largest = (HeadPart::Skin, alpha - weights.iter().sum::<f32>());
    for (&part, &weight) in HeadPart::ALL[1..].iter().zip(weights) {
        if weight > largest.1 {
            largest = (part, weight);
        }
    }
    largest.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_part_with_the_largest_weight_is_shown() {
        let shown = |first, alpha| largest([first, [0.25, 0.0, 0.0]], alpha);
        assert_eq!(shown([0.0; 3], 0.9), HeadPart::Skin);
        assert_eq!(shown([0.0; 3], 0.4), HeadPart::Neck);
        assert_eq!(shown([0.0, 0.1, 0.3], 0.7), HeadPart::Hair);
        assert_eq!(shown([0.0, 0.4, 0.0], 0.7), HeadPart::Mouth);
        for part in HeadPart::ALL {
            assert_eq!(largest([0, 1].map(|pass| paint(part, pass)), 1.0), part);
        }
    }
}
