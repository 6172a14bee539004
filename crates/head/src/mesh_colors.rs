//! Colours that come with a mesh: pictures, one colour for each part, one for each vertex.

use std::collections::HashMap;
use std::sync::{Arc, LazyLock};

use glam::{Affine2, Vec2, Vec3, Vec4};
use srflow_core::Size;
use srflow_files::{FileError, FileProblem, rgba_of_image};

use crate::TextureMap;
use crate::srgb::{linear_from_srgb, srgb_from_linear};

/// The colours of a mesh, without light.
#[derive(Debug, Clone, Default)]
pub struct MeshColors {
    pub(crate) materials: Vec<Material>,
    /// The material of each triangle.
    pub(crate) of_triangles: Vec<u32>,
    /// Linear colour and alpha of each vertex, by which those of the material are multiplied; empty for none.
    pub(crate) of_vertices: Vec<Vec4>,
}

/// What a part of a mesh is made of.
#[derive(Debug, Clone)]
pub(crate) struct Material {
    /// Linear colour and alpha, by which the texture is multiplied.
    pub factor: Vec4,
    pub texture: Option<Arc<Texture>>,
    /// Where in the texture a point is, from its texture coordinates.
    pub texture_from_coordinates: Affine2,
    pub alpha: Alpha,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            factor: Vec4::ONE,
            texture: None,
            texture_from_coordinates: Affine2::IDENTITY,
            alpha: Alpha::Opaque,
        }
    }
}

/// What alpha means.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Alpha {
    /// Nothing.
    Opaque,
    /// Opaque from this alpha on, invisible below.
    Mask(f32),
    Blend,
}

/// A picture on a mesh.
#[derive(Debug)]
pub(crate) struct Texture {
    size: Size,
    texels: Vec<[u8; 4]>,
}

impl Texture {
    /// Of the file of a picture.
    ///
    /// # Errors
    /// As [`rgba_of_image`].
    pub fn parse(bytes: &[u8]) -> Result<Self, FileProblem> {
        let (size, texels) = rgba_of_image(bytes)?;
        Ok(Self { size, texels })
    }

    /// Linear colour and alpha between the four nearest texels. (0, 0) is the lower left corner, (1, 1) the upper right one, and the
    /// picture repeats.
    fn at(&self, point: Vec2) -> Vec4 {
        static LINEAR: LazyLock<[f32; 256]> = LazyLock::new(|| {
            std::array::from_fn(|level| linear_from_srgb(Vec3::splat(level as f32 / 255.0)).x)
        });
        let Size { width, height } = self.size;
        let texel = |column: i64, row: i64| {
            let (column, row) = (column.rem_euclid(width as i64), row.rem_euclid(height as i64));
            let [r, g, b, a] = self.texels[row as usize * width + column as usize];
            let [r, g, b] = [r, g, b].map(|level| LINEAR[usize::from(level)]);
            Vec4::new(r, g, b, f32::from(a) / 255.0)
        };
        let point = point - point.floor();
        let (x, y) = (point.x * width as f32 - 0.5, (1.0 - point.y) * height as f32 - 0.5);
        let (column, row) = (x.floor() as i64, y.floor() as i64);
        let (right, down) = (x - x.floor(), y - y.floor());
        let upper = texel(column, row).lerp(texel(column + 1, row), right);
        upper.lerp(texel(column, row + 1).lerp(texel(column + 1, row + 1), right), down)
    }
}

/// Most pixels of all textures of a mesh.
const MAX_TEXELS: usize = 1 << 28;

/// The textures of a mesh, each read once.
#[derive(Debug, Default)]
pub(crate) struct Textures {
    known: HashMap<String, Option<Arc<Texture>>>,
    texels: usize,
}

impl Textures {
    /// The texture `name`. One that cannot be read is left out with a warning: the rest of the mesh is of use without.
    pub fn get(
        &mut self,
        name: String,
        read: impl FnOnce() -> Result<Texture, FileError>,
    ) -> Option<Arc<Texture>> {
        if let Some(known) = self.known.get(&name) {
            return known.clone();
        }
        let texture = match read() {
            Ok(texture) if self.texels + texture.texels.len() <= MAX_TEXELS => {
                self.texels += texture.texels.len();
                Some(Arc::new(texture))
            }
            Ok(_) => {
                log::warn!("{name} is left out: all textures together have more than {MAX_TEXELS} pixels");
                None
            }
            Err(error) => {
                log::warn!("{name} is left out: {error}");
                None
            }
        };
        self.known.insert(name, texture.clone());
        texture
    }
}

impl MeshColors {
    /// Whether there is more than one colour for each part, as few programs would write for a head.
    pub(crate) fn is_detailed(&self) -> bool {
        !self.of_vertices.is_empty() || self.materials.iter().any(|material| material.texture.is_some())
    }

    /// Whether triangle number `triangle` has a picture.
    pub(crate) fn has_texture(&self, triangle: u32) -> bool {
        self.material(triangle).texture.is_some()
    }

    fn material(&self, triangle: u32) -> &Material {
        &self.materials[self.of_triangles[triangle as usize] as usize]
    }

    /// sRGB colour and alpha, the mean of those at points of a triangle, which has these vertices.
    pub(crate) fn mean(
        &self,
        triangle: u32,
        vertices: [u32; 3],
        map: Option<&TextureMap>,
        points: impl IntoIterator<Item = Vec3>,
    ) -> Vec4 {
        let material = self.material(triangle);
        let texture = material.texture.as_ref().zip(map).map(|(texture, map)| {
            (texture, map.triangles[triangle as usize].map(|corner| map.points[corner as usize]))
        });
        let mut sum = Vec4::ZERO;
        let mut count = 0.0;
        for weights in points {
            let [a, b, c] = weights.to_array();
            let mut color = material.factor;
            if let Some((texture, [p, q, r])) = &texture {
                let point = *p * a + *q * b + *r * c;
                color *= texture.at(material.texture_from_coordinates.transform_point2(point));
            }
            if !self.of_vertices.is_empty() {
                let [p, q, r] = vertices.map(|vertex| self.of_vertices[vertex as usize]);
                color *= p * a + q * b + r * c;
            }
            sum += color;
            count += 1.0;
        }
        let mean = sum / f32::max(count, 1.0);
        let alpha = match material.alpha {
            Alpha::Opaque => 1.0,
            Alpha::Mask(cutoff) => f32::from(mean.w >= cutoff),
            Alpha::Blend => mean.w.clamp(0.0, 1.0),
        };
        srgb_from_linear(mean.truncate().clamp(Vec3::ZERO, Vec3::ONE)).extend(alpha)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Red and green above, blue and half transparent white below.
    fn texture() -> Texture {
        let texels = vec![[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255, 255, 255, 128]];
        Texture { size: Size::new(2, 2), texels }
    }

    #[test]
    fn textures_count_from_below_and_repeat() {
        let texture = texture();
        assert_eq!(texture.at(Vec2::new(0.25, 0.75)), Vec4::new(1.0, 0.0, 0.0, 1.0));
        assert_eq!(texture.at(Vec2::new(-0.75, 2.25)), Vec4::new(0.0, 0.0, 1.0, 1.0));
        assert_eq!(texture.at(Vec2::new(0.5, 0.75)), Vec4::new(0.5, 0.5, 0.0, 1.0));
        // Across the border to the other side.
        assert_eq!(texture.at(Vec2::new(0.0, 0.75)), Vec4::new(0.5, 0.5, 0.0, 1.0));
    }

    #[test]
    fn colours_multiply_in_linear_light() {
        let map = TextureMap {
            points: vec![Vec2::new(0.75, 0.25), Vec2::new(0.75, 0.25), Vec2::new(0.75, 0.25)],
            triangles: vec![[0, 1, 2]],
        };
        let grey = linear_from_srgb(Vec3::splat(0.5));
        let mut colors = MeshColors {
            materials: vec![Material {
                factor: grey.extend(1.0),
                texture: Some(Arc::new(texture())),
                ..Material::default()
            }],
            of_triangles: vec![0],
            of_vertices: vec![Vec4::new(1.0, 0.5, 0.0, 1.0); 3],
        };
        let at = |colors: &MeshColors| colors.mean(0, [0, 1, 2], Some(&map), [Vec3::X]);
        let expected = srgb_from_linear(grey * Vec3::new(1.0, 0.5, 0.0));
        assert!((at(&colors).truncate() - expected).length() < 1e-6, "{}", at(&colors));
        assert!((expected.x - 0.5).abs() < 1e-6);
        for (alpha, expected) in [
            (Alpha::Opaque, 1.0),
            (Alpha::Mask(0.5), 1.0),
            (Alpha::Mask(0.6), 0.0),
            (Alpha::Blend, 128.0 / 255.0),
        ] {
            colors.materials[0].alpha = alpha;
            assert_eq!(at(&colors).w, expected, "{alpha:?}");
        }
    }
}
