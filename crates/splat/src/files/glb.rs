//! Binary glTF with the extension KHR_gaussian_splatting of Khronos
//! (KhronosGroup/glTF, `extensions/2.0/Khronos/KHR_gaussian_splatting/README.md`): a primitive of points per set of Gaussians.
//!
//! | attribute | is |
//! |---|---|
//! | `POSITION` | centre |
//! | `KHR_gaussian_splatting:ROTATION` | unit quaternion x, y, z, w |
//! | `KHR_gaussian_splatting:SCALE` | standard deviations |
//! | `KHR_gaussian_splatting:OPACITY` | 0 to 1 |
//! | `KHR_gaussian_splatting:SH_DEGREE_l_COEF_n` | red, green and blue of a coefficient, with the signs of 3D Gaussian Splatting |
//! | `COLOR_0` | linear colour and opacity, for viewers that show points alone |
//!
//! The extension does not say whether Gaussians are antialiased: `extras` of the extension does, where `antialiased` is true.

use std::path::Path;

use glam::{Quat, Vec3};
use serde_json::{Value, json};
use srflow_files::{FileError, FileKind, FileProblem};

use super::{check, place, problem, unit_rotation};
use crate::gltf::{Document, GltfBuilder, POINTS, Primitive};
use crate::{Gaussians, SH_0, sh};

const EXTENSION: &str = "KHR_gaussian_splatting";
const COLOR_SPACE: &str = "srgb_rec709_display";

/// Reads all Gaussians of the scene, in its coordinates.
pub(super) fn read(path: &Path) -> Result<Gaussians, FileError> {
    let document = Document::open(path, FileKind::Splats)?;
    decode(&document).map_err(|problem| problem.in_file(path))
}

/// Writes a scene of these Gaussians alone.
pub(super) fn write(path: &Path, gaussians: &Gaussians) -> Result<(), FileError> {
    let mut builder = GltfBuilder::new();
    builder.add_gaussians(gaussians).map_err(|problem| problem.in_file(path))?;
    builder.write(path)
}

fn decode(document: &Document) -> Result<Gaussians, FileProblem> {
    let mut sets = Vec::new();
    for placed in document.scene()? {
        let node = &document.json.nodes[placed.node];
        let Some(mesh) = node.mesh else { continue };
        let mesh =
            document.json.meshes.get(mesh).ok_or_else(|| problem("mesh", "one of the file's", mesh))?;
        for primitive in &mesh.primitives {
            if let Some(extension) = primitive.extensions.get(EXTENSION) {
                let mut set = read_primitive(document, primitive, extension)?;
                place(&mut set, placed.global)?;
                sets.push(set);
            }
        }
    }
    let sh_degree = sets.iter().map(|set| set.sh_degree).max().ok_or_else(|| {
        problem("primitives", format!("one or more with the extension {EXTENSION}"), "none in the scene")
    })?;
    let mut all = Gaussians { sh_degree, ..Gaussians::default() };
    all.antialiased = sets.iter().all(|set| set.antialiased);
    for set in sets {
        let missing = sh::coefficients(sh_degree) - set.sh_len();
        for coefficients in set.sh.chunks_exact(set.sh_len()) {
            all.sh.extend(coefficients);
            all.sh.extend(std::iter::repeat_n([0.0; 3], missing));
        }
        all.positions.extend(set.positions);
        all.scales.extend(set.scales);
        all.rotations.extend(set.rotations);
        all.opacities.extend(set.opacities);
    }
    Ok(all)
}

fn read_primitive(
    document: &Document,
    primitive: &Primitive,
    extension: &Value,
) -> Result<Gaussians, FileProblem> {
    let property = |name: &str| extension.get(name).and_then(Value::as_str).unwrap_or_default();
    if primitive.mode != Some(POINTS) {
        return Err(problem("mode", "0 (points) for Gaussians", format!("{:?}", primitive.mode)));
    }
    if property("kernel") != "ellipse" {
        return Err(problem("kernel", "ellipse", property("kernel")));
    }
    if property("colorSpace") != COLOR_SPACE {
        return Err(problem("colorSpace", COLOR_SPACE, property("colorSpace")));
    }
    if let Some(inner) =
        extension.get("extensions").and_then(Value::as_object).and_then(|list| list.keys().next())
    {
        return Err(problem(
            "extensions",
            "Gaussians without another extension; export them without compression",
            inner,
        ));
    }
    let accessor = |name: &str| primitive.attributes.get(name).copied();
    let numbers = |name: String, components: usize, count: Option<usize>| {
        let accessor = accessor(&name).ok_or_else(|| problem("attributes", &name, "none of this name"))?;
        document.numbers(accessor, components, count)
    };
    let own = |name: &str| format!("{EXTENSION}:{name}");
    let positions = numbers("POSITION".to_owned(), 3, None)?;
    let count = positions.len() / 3;
    let vectors =
        |numbers: &[f32]| numbers.as_chunks().0.iter().map(|v| Vec3::from_array(*v)).collect::<Vec<_>>();
    let mut gaussians = Gaussians { positions: vectors(&positions), ..Gaussians::default() };
    let scales = numbers(own("SCALE"), 3, Some(count))?;
    gaussians.scales = vectors(&scales);
    if let Some(index) = gaussians.scales.iter().position(|scale| !scale.cmpge(Vec3::ZERO).all()) {
        let found = format!("{} of Gaussian {index}", gaussians.scales[index]);
        return Err(problem("scale", "lengths, not negative", found));
    }
    let rotations = numbers(own("ROTATION"), 4, Some(count))?;
    for (index, rotation) in rotations.as_chunks::<4>().0.iter().enumerate() {
        gaussians.rotations.push(unit_rotation(rotation.map(f64::from), index)?);
    }
    gaussians.opacities = numbers(own("OPACITY"), 1, Some(count))?;
    if let Some(index) = gaussians.opacities.iter().position(|opacity| !(0.0..=1.0).contains(opacity)) {
        let found = format!("{} of Gaussian {index}", gaussians.opacities[index]);
        return Err(problem("opacity", "0 to 1", found));
    }
    let has = |degree: usize| accessor(&own(&coefficient(degree, 0))).is_some();
    gaussians.sh_degree = (1..=3).take_while(|degree| has(*degree)).count();
    let mut columns = Vec::new();
    for (degree, number) in names(gaussians.sh_degree) {
        columns.push(numbers(own(&coefficient(degree, number)), 3, Some(count))?);
    }
    gaussians.sh.reserve_exact(count * columns.len());
    for index in 0..count {
        let of = |column: &Vec<f32>| [column[3 * index], column[3 * index + 1], column[3 * index + 2]];
        gaussians.sh.extend(columns.iter().map(of));
    }
    let extras = extension.get("extras").and_then(|extras| extras.get("antialiased"));
    gaussians.antialiased = extras.and_then(Value::as_bool).unwrap_or(false);
    Ok(gaussians)
}

/// Degree and number of every coefficient.
fn names(sh_degree: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..=sh_degree).flat_map(|degree| (0..2 * degree + 1).map(move |number| (degree, number)))
}

fn coefficient(degree: usize, number: usize) -> String {
    format!("SH_DEGREE_{degree}_COEF_{number}")
}

impl GltfBuilder {
    /// Adds a node `splats` with these Gaussians.
    ///
    /// # Errors
    /// When there is none, the lists do not match, or a value is not finite or out of range.
    pub fn add_gaussians(&mut self, gaussians: &Gaussians) -> Result<(), FileProblem> {
        check(gaussians)?;
        if gaussians.is_empty() {
            return Err(problem("number of Gaussians", "one or more in a .glb file", 0));
        }
        let sh_len = gaussians.sh_len();
        let rotation = |rotation: &Quat| {
            let [x, y, z, w] = rotation.as_dquat().normalize().as_quat().to_array();
            [x, y, z, w]
        };
        let color = |(sh, opacity): (&[[f32; 3]], &f32)| {
            let [r, g, b] = sh[0].map(|channel| linear(0.5 + SH_0 * f64::from(channel)));
            [r, g, b, f64::from(*opacity)].map(|value| (value * 65535.0).round() as u16)
        };
        let mut attributes = serde_json::Map::new();
        let positions = self.floats(gaussians.positions.iter().map(Vec3::to_array));
        attributes.insert("POSITION".into(), positions.into());
        let colors = self.colors(gaussians.sh.chunks_exact(sh_len).zip(&gaussians.opacities).map(color));
        attributes.insert("COLOR_0".into(), colors.into());
        let rotations = self.floats(gaussians.rotations.iter().map(rotation));
        attributes.insert(format!("{EXTENSION}:ROTATION"), rotations.into());
        let scales = self.floats(gaussians.scales.iter().map(Vec3::to_array));
        attributes.insert(format!("{EXTENSION}:SCALE"), scales.into());
        let opacities = self.floats(gaussians.opacities.iter().map(|opacity| [*opacity]));
        attributes.insert(format!("{EXTENSION}:OPACITY"), opacities.into());
        for (column, (degree, number)) in names(gaussians.sh_degree).enumerate() {
            let coefficients = self.floats(gaussians.sh.iter().skip(column).step_by(sh_len).copied());
            attributes.insert(format!("{EXTENSION}:{}", coefficient(degree, number)), coefficients.into());
        }
        let mut extension = json!({
            "kernel": "ellipse",
            "colorSpace": COLOR_SPACE,
            "projection": "perspective",
            "sortingMethod": "cameraDistance",
        });
        if gaussians.antialiased {
            extension["extras"] = json!({"antialiased": true});
        }
        self.use_extension(EXTENSION);
        let primitive =
            json!({"attributes": attributes, "mode": POINTS, "extensions": {EXTENSION: extension}});
        self.add_mesh("splats", &json!({"primitives": [primitive]}));
        Ok(())
    }
}

/// The linear value of an sRGB one, within 0..=1 (IEC 61966-2-1), as `COLOR_0` has it.
fn linear(value: f64) -> f64 {
    let value = value.clamp(0.0, 1.0);
    if value <= 0.040_45 { value / 12.92 } else { libm::pow((value + 0.055) / 1.055, 2.4) }
}
