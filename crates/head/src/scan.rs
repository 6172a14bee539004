//! Meshes that nothing moves, such as scans: Wavefront OBJ with its materials.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::Vec3;
use srflow_core::excerpt;
use srflow_files::{FileError, FileKind, FileProblem, file_beside, read_file};

use crate::found_head::{found_head, region_of_name};
use crate::mesh_colors::{Alpha, Material, MeshColors, Texture, Textures};
use crate::obj::{Obj, read_obj};
use crate::srgb::linear_from_srgb;
use crate::{HeadError, HeadModel, Joint, Look, Region, Skinning, TextureMap};

/// Reads a mesh, its materials and textures, and with landmarks beside it gives it the built-in head's action units.
///
/// # Errors
/// Names the file that is missing or malformed.
pub(crate) fn load(path: &Path, look: Look) -> Result<HeadModel, HeadError> {
    let obj = read_obj(path)?;
    if obj.polygons.is_empty() {
        return Err(FileProblem::field("f", "a mesh of polygons", "none").in_file(path).into());
    }
    let mut textures = Textures::default();
    let described = materials(path, &obj, &mut textures)?;
    let of_name = |name: &String| described.get(name).cloned().unwrap_or_default();
    let mut colors = MeshColors {
        materials: obj.materials.iter().map(of_name).collect(),
        of_triangles: Vec::new(),
        of_vertices: obj.colors.iter().map(|color| linear_from_srgb(*color).extend(1.0)).collect(),
    };
    let region_of: Vec<Region> = obj.materials.iter().map(|name| region_of_name(name)).collect();
    let (mut triangles, mut regions, mut corners) = (Vec::new(), Vec::new(), Vec::new());
    for (number, polygon) in obj.polygons.iter().enumerate() {
        let material = obj.material_of_polygons[number];
        for i in 2..polygon.len() {
            triangles.push([polygon[0], polygon[i - 1], polygon[i]]);
            regions.push(region_of[material as usize]);
            colors.of_triangles.push(material);
            corners
                .extend(obj.texture_polygons.get(number).map(|points| [points[0], points[i - 1], points[i]]));
        }
    }
    let mut skinning = Skinning::default();
    obj.positions.iter().for_each(|_| skinning.push([(0, 1.0)]));
    let texture = (!corners.is_empty()).then_some(TextureMap { points: obj.texture, triangles: corners });
    let model = HeadModel {
        name: "obj".into(),
        template: obj.positions,
        triangles,
        regions,
        identities: Vec::new(),
        expressions: Vec::new(),
        joints: Joint::of_roles([Vec3::ZERO; 5]).into_iter().take(1).collect(),
        joints_follow_expressions: false,
        expressions_are_components: false,
        skinning,
        pose_correctives: Vec::new(),
        action_units: Vec::new(),
        landmarks: Vec::new(),
        eyeballs: [Vec::new(), Vec::new()],
        texture,
        colors: colors.is_detailed().then_some(colors),
        vertex_groups: BTreeMap::new(),
        carried: Vec::new(),
    };
    found_head(model, path, look)
}

/// The materials that the files beside a mesh describe, by name. A missing file is left out with a warning, as textures are.
fn materials(
    path: &Path,
    obj: &Obj,
    textures: &mut Textures,
) -> Result<HashMap<String, Material>, HeadError> {
    let mut materials = HashMap::new();
    for library in &obj.libraries {
        match named_beside(path, library).and_then(|file| Ok((read_file(&file, FileKind::Settings)?, file))) {
            Ok((bytes, file)) => read_materials(&file, &bytes, textures, &mut materials)?,
            Err(error) => log::warn!("{}: the materials are left out: {error}", path.display()),
        }
    }
    Ok(materials)
}

/// The files of materials and textures that a mesh names, as far as they exist.
pub(crate) fn files_named_in(path: &Path) -> Vec<PathBuf> {
    let named = |path: &Path, key: &str| -> Vec<PathBuf> {
        let bytes = read_file(path, FileKind::Mesh).unwrap_or_default();
        let text = String::from_utf8_lossy(&bytes);
        let names = text.lines().filter_map(|line| line.trim().strip_prefix(key));
        names
            .filter_map(|name| file_beside(path, name_of(name.trim())))
            .filter(|path| path.exists())
            .collect()
    };
    let libraries = named(path, "mtllib ");
    let textures = libraries.iter().flat_map(|library| named(library, "map_Kd ")).collect();
    [libraries, textures].concat()
}

/// The name of a file in a statement: options come before it, and it may have spaces.
fn name_of(statement: &str) -> &str {
    if statement.starts_with('-') { statement.rsplit(' ').next().unwrap_or(statement) } else { statement }
}

/// Reads the colours (`Kd`), opacity (`d`, `Tr`) and pictures (`map_Kd`) of materials (`newmtl`).
fn read_materials(
    path: &Path,
    bytes: &[u8],
    textures: &mut Textures,
    materials: &mut HashMap<String, Material>,
) -> Result<(), HeadError> {
    let text = String::from_utf8_lossy(bytes);
    let mut current: Option<&mut Material> = None;
    for (line, number) in text.lines().zip(1..) {
        let (key, rest) = line.trim().split_once([' ', '\t']).unwrap_or((line.trim(), ""));
        let rest = rest.trim();
        if key == "newmtl" {
            current = Some(materials.entry(rest.to_owned()).or_default());
            continue;
        }
        let Some(material) = &mut current else { continue };
        let malformed = |expected: &str| HeadError::Malformed {
            path: path.to_owned(),
            line: number,
            problem: format!("expected {expected}, found `{}`", excerpt(rest)),
        };
        let opacity = || rest.parse().ok().filter(|alpha| (0.0..=1.0).contains(alpha));
        match key {
            "Kd" => {
                let color = color(rest).ok_or_else(|| malformed("three numbers from 0 to 1"))?;
                material.factor = linear_from_srgb(color).extend(material.factor.w);
            }
            "d" | "Tr" => {
                let alpha: f32 = opacity().ok_or_else(|| malformed("a number from 0 to 1"))?;
                let alpha = if key == "d" { alpha } else { 1.0 - alpha };
                material.factor.w = alpha;
                if alpha < 1.0 {
                    material.alpha = Alpha::Blend;
                }
            }
            "map_Kd" => {
                material.texture = texture(path, name_of(rest), textures);
                // Programs leave black or grey behind where a picture has the colours.
                material.factor = Vec3::ONE.extend(material.factor.w);
            }
            _ => {}
        }
    }
    Ok(())
}

/// sRGB; one number is grey.
fn color(text: &str) -> Option<Vec3> {
    let numbers: Vec<f32> = text.split_ascii_whitespace().map(str::parse).collect::<Result<_, _>>().ok()?;
    let color = match numbers[..] {
        [grey] => Vec3::splat(grey),
        [r, g, b] => Vec3::new(r, g, b),
        _ => return None,
    };
    (color.is_finite() && color.min_element() >= 0.0).then(|| color.min(Vec3::ONE))
}

fn texture(path: &Path, name: &str, textures: &mut Textures) -> Option<Arc<Texture>> {
    textures.get(format!("{}, texture {}", path.display(), excerpt(name)), || {
        let file = named_beside(path, name)?;
        Texture::parse(&read_file(&file, FileKind::Image)?).map_err(|problem| problem.in_file(&file))
    })
}

fn named_beside(path: &Path, name: &str) -> Result<PathBuf, FileError> {
    file_beside(path, name).ok_or_else(|| {
        let expected = "the name of a file in the same folder, or below it";
        FileProblem::field("file", expected, excerpt(name)).in_file(path)
    })
}

#[cfg(test)]
mod tests {
    use glam::Vec4;

    use super::*;

    const TETRAHEDRON: &str = "mtllib head.mtl\nv 0 0 0\nv 0.2 0 0\nv 0 0.3 0\nv 0 0 0.2\nvt 0.25 0.75\nvt 0.75 0.25\n\
                               usemtl skin\nf 1/1 3/1 2/1\nf 1/1 2/1 4/1\nusemtl Eye\nf 2/2 3/2 4/2 1/2\n";

    fn written(files: &[(&str, &[u8])]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in files {
            std::fs::write(folder.path().join(name), bytes).unwrap();
        }
        folder
    }

    fn read(folder: &tempfile::TempDir) -> Result<HeadModel, HeadError> {
        load(&folder.path().join("head.obj"), Look::default())
    }

    /// A picture of two by two pixels: red and green above, blue and white below.
    fn picture() -> Vec<u8> {
        b"P6 2 2 255\n\xff\0\0\0\xff\0\0\0\xff\xff\xff\xff".to_vec()
    }

    fn color_of(model: &HeadModel, triangle: u32) -> Vec4 {
        let colors = model.colors.as_ref().unwrap();
        let vertices = model.triangles[triangle as usize];
        colors.mean(triangle, vertices, model.texture.as_ref(), [Vec3::splat(1.0 / 3.0)])
    }

    #[test]
    fn materials_and_textures_give_colours() {
        let materials =
            "newmtl skin\nKd 0 0 0\nmap_Kd -s 1 1 1 skin.ppm\n\nnewmtl Eye\nKd 0.5 0.25 1\nd 0.5\nNs 10\n";
        let folder = written(&[
            ("head.obj", TETRAHEDRON.as_bytes()),
            ("head.mtl", materials.as_bytes()),
            ("skin.ppm", &picture()),
        ]);
        let model = read(&folder).unwrap();
        assert_eq!(model.regions, [Region::Skin, Region::Skin, Region::Eyeball, Region::Eyeball]);
        assert!((color_of(&model, 0) - Vec4::new(1.0, 0.0, 0.0, 1.0)).length() < 1e-5);
        assert!((color_of(&model, 2) - Vec4::new(0.5, 0.25, 1.0, 0.5)).length() < 1e-5);
        let named = ["head.mtl", "skin.ppm"].map(|name| folder.path().join(name));
        assert_eq!(files_named_in(&folder.path().join("head.obj")), named);
        // Nothing says where the face is.
        assert!(model.landmarks.is_empty() && model.action_units.is_empty());
    }

    #[test]
    fn colours_behind_positions_are_of_vertices() {
        let text = "v 0 0 0 1 0 0\nv 0.2 0 0 1 0 0\nv 0 0.3 0 1 0 0\nf 1 2 3\n";
        let model = read(&written(&[("head.obj", text.as_bytes())])).unwrap();
        assert!((color_of(&model, 0) - Vec4::new(1.0, 0.0, 0.0, 1.0)).length() < 1e-5);
        let plain = text.replace(" 1 0 0\n", "\n");
        assert!(read(&written(&[("head.obj", plain.as_bytes())])).unwrap().colors.is_none());
    }

    #[test]
    fn missing_and_strange_files_leave_the_mesh() {
        let model = read(&written(&[("head.obj", TETRAHEDRON.as_bytes())])).unwrap();
        assert!(model.colors.is_none() && model.triangles.len() == 4);
        for name in ["../skin.ppm", "/etc/passwd", "C:\\skin.ppm", "none.png", "head.obj"] {
            let materials = format!("newmtl skin\nmap_Kd {name}\n");
            let folder = written(&[("head.obj", TETRAHEDRON.as_bytes()), ("head.mtl", materials.as_bytes())]);
            assert!(read(&folder).unwrap().colors.is_none(), "{name}");
        }
        for (materials, expected) in [
            ("newmtl a\nKd 1 2\n", "head.mtl:2: expected three numbers"),
            ("newmtl a\nd x\n", ":2: expected a number"),
        ] {
            let folder = written(&[("head.obj", TETRAHEDRON.as_bytes()), ("head.mtl", materials.as_bytes())]);
            let message = read(&folder).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
        let message = read(&written(&[("head.obj", b"v 0 0 0\n")])).unwrap_err().to_string();
        assert!(message.contains("a mesh of polygons"), "{message}");
    }
}
