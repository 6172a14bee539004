//! What meshes are made of, as far as it gives them their own colour.

use glam::{Affine2, Vec2};
use serde::Deserialize;

/// What a primitive is made of. Only what gives it its own colour is read, not what light does to it.
#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct Material {
    pub name: String,
    pbr_metallic_roughness: MetallicRoughness,
    pub alpha_mode: String,
    pub alpha_cutoff: Option<f32>,
    extensions: MaterialExtensions,
}

impl Material {
    /// Linear RGB and alpha, by which the texture's colours are multiplied.
    pub fn factor(&self) -> [f32; 4] {
        let base = &self.pbr_metallic_roughness;
        self.extensions
            .specular_glossiness
            .as_ref()
            .map_or(base.base_color_factor, |old| old.diffuse_factor)
            .unwrap_or([1.0; 4])
    }

    /// The picture of its colours.
    pub fn texture(&self) -> Option<&TextureInfo> {
        let base = &self.pbr_metallic_roughness;
        let old = self.extensions.specular_glossiness.as_ref();
        old.map_or(base.base_color_texture.as_ref(), |old| old.diffuse_texture.as_ref())
    }
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct MetallicRoughness {
    base_color_factor: Option<[f32; 4]>,
    base_color_texture: Option<TextureInfo>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct MaterialExtensions {
    #[serde(rename = "KHR_materials_pbrSpecularGlossiness")]
    specular_glossiness: Option<SpecularGlossiness>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct SpecularGlossiness {
    diffuse_factor: Option<[f32; 4]>,
    diffuse_texture: Option<TextureInfo>,
}

/// A texture on a material.
#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub struct TextureInfo {
    /// Number of the texture.
    pub index: usize,
    tex_coord: usize,
    extensions: TextureInfoExtensions,
}

impl TextureInfo {
    /// Number of the set of texture coordinates.
    pub fn coordinates(&self) -> usize {
        self.extensions.transform.as_ref().and_then(|transform| transform.tex_coord).unwrap_or(self.tex_coord)
    }

    /// Where the texture is looked up, from texture coordinates; v counts from the top.
    pub fn texture_from_coordinates(&self) -> Affine2 {
        self.extensions.transform.as_ref().map_or(Affine2::IDENTITY, |transform| {
            // Counter-clockwise where v counts from the top, as three.js and Khronos' viewer do it.
            Affine2::from_scale_angle_translation(
                Vec2::from_array(transform.scale.unwrap_or([1.0; 2])),
                -transform.rotation,
                Vec2::from_array(transform.offset),
            )
        })
    }
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct TextureInfoExtensions {
    #[serde(rename = "KHR_texture_transform")]
    transform: Option<TextureTransform>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct TextureTransform {
    offset: [f32; 2],
    rotation: f32,
    scale: Option<[f32; 2]>,
    tex_coord: Option<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Texture {
    source: Option<usize>,
    extensions: TextureExtensions,
}

impl Texture {
    /// Number of its picture.
    pub fn image(&self) -> Option<usize> {
        self.extensions.webp.as_ref().and_then(|webp| webp.source).or(self.source)
    }
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct TextureExtensions {
    #[serde(rename = "EXT_texture_webp")]
    webp: Option<TextureSource>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct TextureSource {
    source: Option<usize>,
}
