use glam::{Quat, Vec3};

use crate::{RasterizeError, sh};

/// A turn by 180 degrees that brings up to down.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HalfTurn {
    /// About x, which points to the right: front and back change too, as between OpenCV's axes and OpenGL's.
    X,
    /// About z: front stays in front.
    Z,
}

/// A set of 3D Gaussians, one entry of each list per Gaussian. Values are activated: scales are standard deviations in
/// world units (not their logarithms), opacities are probabilities (not logits), rotations are unit quaternions.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Gaussians {
    /// Centres in world units.
    pub positions: Vec<Vec3>,
    /// Standard deviations along the rotated axes, world units.
    pub scales: Vec<Vec3>,
    /// World from Gaussian rotations.
    pub rotations: Vec<Quat>,
    /// Opacity at the centre, `0..=1`.
    pub opacities: Vec<f32>,
    /// Spherical-harmonics degree, 0 to 3.
    pub sh_degree: usize,
    /// Spherical-harmonics colour coefficients: `(sh_degree + 1)^2` entries per Gaussian, each `[r, g, b]`, starting with degree
    /// 0. Colour is `max(0, 0.5 + sum of coefficient times basis)`, as in the 3DGS reference.
    pub sh: Vec<[f32; 3]>,
    /// Whether the low-pass filter, which makes every Gaussian about a pixel wide at least, reduces its opacity by the factor
    /// by which it enlarges its area: `sqrt(det S / det(S + 0.3 I))`, with `S` the projected covariance. A Gaussian smaller than
    /// a pixel then contributes in proportion to its area at any distance. This is the 2D filter of Mip-Splatting (Yu et al.
    /// 2024) as in gsplat's `rasterize_mode="antialiased"` and the 3DGS reference's `--antialiasing`. It belongs to the Gaussians
    /// and not to a rendering: they look right only as they were trained.
    pub antialiased: bool,
}

impl Gaussians {
    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Coefficients per Gaussian: `(sh_degree + 1)^2`.
    pub fn sh_len(&self) -> usize {
        sh::coefficients(self.sh_degree)
    }

    /// Turns the world by 180 degrees, exactly: two coordinates change their signs, and with them rotations and spherical
    /// harmonics. What was upright where -y is up (OpenCV's axes) is upright where +y is (glTF's), and the reverse.
    pub fn half_turn(&mut self, about: HalfTurn) {
        let degree = self.sh_degree.min(3);
        let signs = match about {
            HalfTurn::X => {
                sh::turn_about_x(degree, &mut self.sh);
                Vec3::new(1.0, -1.0, -1.0)
            }
            HalfTurn::Z => {
                sh::turn_about_z(degree, &mut self.sh);
                Vec3::new(-1.0, -1.0, 1.0)
            }
        };
        for position in &mut self.positions {
            *position *= signs;
        }
        for rotation in &mut self.rotations {
            *rotation = Quat::from_vec4((rotation.xyz() * signs).extend(rotation.w));
        }
    }

    /// Checks that the lists have matching lengths; `set` names the set in the error.
    pub(crate) fn validate(&self, set: &'static str) -> Result<(), RasterizeError> {
        if self.sh_degree > 3 {
            return Err(RasterizeError::ShDegree(self.sh_degree));
        }
        let lists = [
            ("scales", self.scales.len(), 1),
            ("rotations", self.rotations.len(), 1),
            ("opacities", self.opacities.len(), 1),
            ("sh", self.sh.len(), self.sh_len()),
        ];
        for (list, found, each) in lists {
            let needed = self.len() * each;
            if found != needed {
                return Err(RasterizeError::ListLength { set, list, expected: self.len(), needed, found });
            }
        }
        Ok(())
    }
}
