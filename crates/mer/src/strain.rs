//! Optical strain: how much the flow stretches and shears the skin.

use srflow_core::{FlowField, Image, Plane, Size, named, serialize_as_text};

/// How strain is computed from the flow's derivatives `ux`, `uy`, `vx`, `vy`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum StrainFormula {
    /// `sqrt(ux² + vy² + ½(uy + vx)²)`, the magnitude of the infinitesimal strain tensor (Liong et al., *Subtle expression
    /// recognition using optical strain weighted features*, ACCV Workshops 2014). Derivatives are per pixel: Sobel / 8.
    #[default]
    Literature,
    /// The formula in Off-TANet's published code (`data.py`): `sqrt(ux² + uy² + ½(vx + uy)²)`, with `uy` in place of `vy`, and
    /// derivatives by Sobel without the 1/8. It ignores vertical stretching.
    OffTaNet,
}

named!(StrainFormula, "a strain formula", { Literature => "literature", OffTaNet => "off-tanet" });
serialize_as_text!(StrainFormula);

/// Optical strain of a flow, in its size. Derivatives are those of OpenCV's 3x3 `Sobel`, with borders mirrored without repeating
/// the outermost pixel (`BORDER_REFLECT_101`).
pub fn optical_strain(flow: &FlowField, formula: StrainFormula) -> Plane {
    let Size { width, height } = flow.size();
    Plane::from_fn(width, height, |x, y| {
        let [[ux, uy], [vx, vy]] = sobel(flow, x, y);
        match formula {
            StrainFormula::Literature => {
                let [ux, uy, vx, vy] = [ux, uy, vx, vy].map(|derivative| derivative / 8.0);
                (ux * ux + vy * vy + 0.5 * (uy + vx) * (uy + vx)).sqrt()
            }
            StrainFormula::OffTaNet => (ux * ux + uy * uy + 0.5 * (vx + uy) * (vx + uy)).sqrt(),
        }
    })
}

/// Eight times the derivatives at a pixel: `[[ux, uy], [vx, vy]]`.
fn sobel(flow: &FlowField, x: usize, y: usize) -> [[f32; 2]; 2] {
    let columns = neighbours(x, flow.width());
    let rows = neighbours(y, flow.height());
    let mut sums = [[0.0; 2]; 2];
    for (row, weight_y, sign_y) in [(rows[0], 1.0, -1.0), (rows[1], 2.0, 0.0), (rows[2], 1.0, 1.0)] {
        for (column, weight_x, sign_x) in
            [(columns[0], 1.0, -1.0), (columns[1], 2.0, 0.0), (columns[2], 1.0, 1.0)]
        {
            let value = flow.get(column, row);
            for component in 0..2 {
                sums[component][0] += weight_y * sign_x * value[component];
                sums[component][1] += weight_x * sign_y * value[component];
            }
        }
    }
    sums
}

/// The previous, current and next index, mirrored at the ends.
fn neighbours(at: usize, len: usize) -> [usize; 3] {
    let last = len.saturating_sub(1);
    let before = if at == 0 { 1.min(last) } else { at - 1 };
    let after = if at >= last { last.saturating_sub(1) } else { at + 1 };
    [before, at, after]
}

/// Strain as a picture: black is zero, then red, yellow, and white at `max` or more; by default (or if not positive) `max` is the
/// maximum of the plane.
pub fn strain_colors(strain: &Plane, max: Option<f32>) -> Image {
    let greatest = || strain.pixels().iter().copied().filter(|value| value.is_finite()).fold(0.0, f32::max);
    let max = max.filter(|max| *max > 0.0).unwrap_or_else(greatest).max(f32::MIN_POSITIVE);
    Image::from_fn(strain.width(), strain.height(), |x, y| {
        let heat = 3.0 * strain.get(x, y) / max;
        // The cast clamps to 0..=255; NaN becomes 0.
        [heat, heat - 1.0, heat - 2.0].map(|channel| (255.0 * channel.min(1.0)) as u8)
    })
}
