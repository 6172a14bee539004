//! PLY files of 3D Gaussians, as written by the 3DGS reference and read by every splat viewer
//! (ShenhanQian/GaussianAvatars, `scene/gaussian_model.py`, `save_ply` and `load_ply`).
//!
//! One element `vertex` with the properties `x y z nx ny nz f_dc_0..2 f_rest_* opacity scale_0..2 rot_0..3`. The file stores
//! raw parameters: `ln(scale)`, the logit of the opacity, a quaternion `w x y z` of any length, and `f_rest` channel by
//! channel (all of red, then green, then blue). GaussianAvatars adds `binding_0`, the number of the triangle in whose coordinates
//! the Gaussian is.

mod compressed;
mod header;

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::Path;

use glam::Vec3;
use srflow_core::{excerpt, excerpts};
use srflow_files::{FileError, FileKind, FileProblem, open_file, write_atomically};

use super::{Invisible, check, problem, room_for, unit_rotation};
use crate::{Gaussians, sh};
use header::{Body, Element, Header};

/// Raw values that are read back as exactly 0 and 1 (scale or opacity 0, opacity 1).
const RAW_ZERO: f64 = -110.0;
const RAW_ONE: f64 = 20.0;

/// Largest number of a triangle: every integer up to it is an `f32`.
const MAX_TRIANGLE: u32 = 1 << 24;

/// Degree of the spherical harmonics in files for GaussianAvatars.
const FULL_DEGREE: usize = 3;

/// Reads 3D Gaussians; the spherical-harmonics degree follows from the number of `f_rest` properties (0, 9, 24 or 45).
/// Properties may have any order and type, and other properties (colours, normals) are ignored; binary files of either byte
/// order and ASCII files are read, and compressed ones of SuperSplat. A comment `SplatRenderMode: mip`, as Brush writes it, means
/// antialiased ones. An infinite opacity is 1 or 0, a scale of minus infinity 0. Gaussians with other numbers that are not finite keep
/// their place, so that those of two files correspond, but are invisible, and their number is noted.
///
/// # Errors
/// When the file cannot be read, is not a PLY of 3D Gaussians, contains Gaussians bound to a mesh (`binding_0` of
/// GaussianAvatars: they are in the coordinates of their triangles), is shorter or longer than its header claims, or contains
/// a scale too large for `f32`, or a quaternion of length zero; the error names the vertex.
pub fn read_ply(path: &Path) -> Result<Gaussians, FileError> {
    Ok(read(path, false)?.0)
}

/// Reads 3D Gaussians that are bound to the triangles of a mesh (`point_cloud.ply` of GaussianAvatars): the Gaussians in the
/// coordinates of their triangles, and the number of each one's triangle (`binding_0`).
///
/// # Errors
/// As [`read_ply`], and when the file has no binding or one that is not an integer from 0.
pub fn read_bound_ply(path: &Path) -> Result<(Gaussians, Vec<u32>), FileError> {
    read(path, true)
}

/// As [`read_ply`], for a file whose bytes are known; `path` names it in errors.
///
/// # Errors
/// As [`read_ply`].
pub fn parse_ply(path: &Path, mut bytes: &[u8]) -> Result<Gaussians, FileError> {
    let len = bytes.len() as u64;
    let read = decode(&mut bytes, len, false).map_err(|problem| problem.in_file(path))?;
    read.invisible.note(path, &read.gaussians);
    Ok(read.gaussians)
}

fn read(path: &Path, bound: bool) -> Result<(Gaussians, Vec<u32>), FileError> {
    let in_file = |problem| FileError { path: path.to_owned(), problem };
    let (file, len) = open_file(path, FileKind::Splats)?;
    let read = decode(&mut BufReader::with_capacity(1 << 18, file), len, bound).map_err(in_file)?;
    read.invisible.note(path, &read.gaussians);
    Ok((read.gaussians, read.triangles))
}

/// The contents of a file.
#[derive(Debug, Default)]
struct Decoded {
    gaussians: Gaussians,
    triangles: Vec<u32>,
    invisible: Invisible,
}

/// Writes 3D Gaussians, binary little-endian in the reference's order, whole or not at all
/// (see [`write_atomically`]).
///
/// # Errors
/// When the lists do not match, a value has no raw form (not finite, a negative scale, an opacity outside 0..=1), or the
/// file cannot be written.
pub fn write_ply(path: &Path, gaussians: &Gaussians) -> Result<(), FileError> {
    write(path, gaussians, None)
}

/// Writes 3D Gaussians that are bound to triangles, as GaussianAvatars does; see [`read_bound_ply`]. The spherical harmonics are
/// filled up with zeros to degree 3, which that program expects.
///
/// # Errors
/// As [`write_ply`], and when there is not one triangle per Gaussian, or a triangle's number is beyond 2^24, the largest range of
/// integers of the file's `f32`.
pub fn write_bound_ply(path: &Path, gaussians: &Gaussians, triangles: &[u32]) -> Result<(), FileError> {
    write(path, gaussians, Some(triangles))
}

fn write(path: &Path, gaussians: &Gaussians, triangles: Option<&[u32]>) -> Result<(), FileError> {
    let in_file = |problem| FileError { path: path.to_owned(), problem };
    check(gaussians).map_err(in_file)?;
    if let Some(triangles) = triangles {
        if triangles.len() != gaussians.len() {
            let expected = format!("one triangle for each of {} Gaussians", gaussians.len());
            return Err(in_file(problem("binding_0", expected, triangles.len())));
        }
        if let Some(beyond) = triangles.iter().find(|triangle| **triangle > MAX_TRIANGLE) {
            return Err(in_file(problem("binding_0", format!("triangles up to {MAX_TRIANGLE}"), beyond)));
        }
    }
    write_atomically(path, |writer| encode(gaussians, triangles, writer))
}

/// Positions of a Gaussian's parameters among the values of a vertex.
struct Layout {
    position: [usize; 3],
    scale: [usize; 3],
    /// w, x, y, z.
    rotation: [usize; 4],
    opacity: usize,
    sh_degree: usize,
    /// Red, green and blue of each coefficient.
    sh: Vec<[usize; 3]>,
    binding: Option<usize>,
}

impl Layout {
    /// The layout of Gaussians in the world, or of `bound` ones.
    fn new(vertex: &Element, bound: bool) -> Result<Self, FileProblem> {
        if let Some(list) = vertex.properties.iter().find(|property| property.length.is_some()) {
            return Err(problem(
                "vertex properties",
                "single numbers",
                format!("the list `{}`", excerpt(&list.name)),
            ));
        }
        let names: Vec<&str> = vertex.properties.iter().map(|property| property.name.as_str()).collect();
        Self::of_names(&names, bound)
    }

    fn of_names(names: &[&str], bound: bool) -> Result<Self, FileProblem> {
        let find = |name: &str| {
            names.iter().position(|property| *property == name).ok_or_else(|| {
                problem(
                    "vertex properties",
                    format!("`{name}`, a required property of 3D Gaussians"),
                    format!("{} properties: {}", names.len(), excerpts(names.iter().copied(), 20)),
                )
            })
        };
        let binding = names.iter().position(|name| *name == "binding_0");
        if binding.is_some() && !bound {
            return Err(problem(
                "vertex properties",
                "Gaussians in the world (each of these is bound to a triangle of a mesh, as in GaussianAvatars: give the \
                 folder of the avatar as `head` avatar:DIR)",
                "`binding_0`",
            ));
        }
        if binding.is_none() && bound {
            return Err(problem(
                "vertex properties",
                "`binding_0`, the triangle of each Gaussian (GaussianAvatars writes it when trained with --bind_to_mesh)",
                "none: these Gaussians are bound to no mesh",
            ));
        }
        let rest = names.iter().filter(|name| name.starts_with("f_rest_")).count();
        let sh_degree =
            (0..=3).find(|&degree| 3 * (sh::coefficients(degree) - 1) == rest).ok_or_else(|| {
                problem("f_rest", "0, 9, 24 or 45 properties (degree 0 to 3)", format!("{rest} properties"))
            })?;
        let per_channel = rest / 3;
        let mut sh = vec![[find("f_dc_0")?, find("f_dc_1")?, find("f_dc_2")?]];
        for coefficient in 0..per_channel {
            let of = |channel: usize| find(&format!("f_rest_{}", channel * per_channel + coefficient));
            sh.push([of(0)?, of(1)?, of(2)?]);
        }
        Ok(Self {
            position: [find("x")?, find("y")?, find("z")?],
            scale: [find("scale_0")?, find("scale_1")?, find("scale_2")?],
            rotation: [find("rot_0")?, find("rot_1")?, find("rot_2")?, find("rot_3")?],
            opacity: find("opacity")?,
            sh_degree,
            sh,
            binding,
        })
    }

    /// Appends the triangle of vertex number `index`, if vertices have one.
    fn push_triangle(&self, triangles: &mut Vec<u32>, values: &[f64], index: u64) -> Result<(), FileProblem> {
        let Some(at) = self.binding else { return Ok(()) };
        let value = values[at];
        if value.fract() != 0.0 || !(0.0..=f64::from(MAX_TRIANGLE)).contains(&value) {
            return Err(problem(
                "binding_0",
                "the number of a triangle",
                format!("{value} at vertex {index}"),
            ));
        }
        triangles.push(value as u32);
        Ok(())
    }

    /// Activates the values of vertex number `index` and appends the Gaussian.
    fn push(&self, to: &mut Decoded, values: &[f64], index: u64) -> Result<(), FileProblem> {
        let get = |at: usize| values[at] as f32;
        let position = Vec3::from(self.position.map(get));
        let raw = self.scale.map(get);
        let opacity = 1.0 / (1.0 + libm::exp(-f64::from(get(self.opacity))));
        let rotation = self.rotation.map(get);
        let sh = self.sh.iter().map(|of| of.map(get));
        let finite = position.is_finite() && rotation.iter().all(|part| part.is_finite());
        let Decoded { gaussians, invisible, .. } = to;
        if !finite
            || opacity.is_nan()
            || raw.iter().any(|raw| raw.is_nan())
            || !sh.clone().flatten().all(f32::is_finite)
        {
            invisible.push(gaussians);
            return Ok(());
        }
        let scale = raw.map(|raw| libm::exp(f64::from(raw)) as f32);
        if !scale.iter().all(|scale| scale.is_finite()) {
            let found = format!("{:?} at vertex {index}", self.scale.map(|at| values[at]));
            return Err(problem("scale", "logarithms of lengths, under 88", found));
        }
        let [w, x, y, z] = rotation;
        let rotation = unit_rotation([x, y, z, w].map(f64::from), gaussians.len())?;

        gaussians.positions.push(position);
        gaussians.scales.push(Vec3::from(scale));
        gaussians.rotations.push(rotation);
        gaussians.opacities.push(opacity as f32);
        gaussians.sh.extend(sh);
        Ok(())
    }
}

fn decode(reader: &mut impl Read, len: u64, bound: bool) -> Result<Decoded, FileProblem> {
    let header = Header::read(reader)?;
    let elements = &header.elements;
    let at = elements.iter().position(|element| element.name == "vertex");
    let at = at.ok_or_else(|| problem("element", "`vertex`", "none"))?;
    let (before, vertex) = (&elements[..at], &elements[at]);
    let mut body = Body::new(reader, header.encoding);
    if vertex.find("packed_position").is_some() {
        header.check_file_size(len)?;
        return compressed::decode(&header, body);
    }
    let layout = Layout::new(vertex, bound)?;
    header.check_file_size(len)?;
    before.iter().try_for_each(|element| body.skip(element))?;
    let mut decoded = Decoded { gaussians: room_for(vertex.count, layout.sh_degree)?, ..Decoded::default() };
    decoded.gaussians.antialiased = header.antialiased;
    let mut values = vec![0.0; vertex.properties.len()];
    for index in 0..vertex.count {
        body.row(vertex, index, &mut values)?;
        layout.push(&mut decoded, &values, index)?;
        layout.push_triangle(&mut decoded.triangles, &values, index)?;
    }
    if at + 1 == elements.len() {
        body.end()?;
    }
    Ok(decoded)
}

fn encode(gaussians: &Gaussians, triangles: Option<&[u32]>, writer: &mut BufWriter<File>) -> io::Result<()> {
    let sh_len = gaussians.sh_len();
    let rest = if triangles.is_some() { sh::coefficients(FULL_DEGREE) } else { sh_len } - 1;
    let names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"].map(String::from).into_iter();
    let names = names.chain((0..3 * rest).map(|i| format!("f_rest_{i}")));
    let last = ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"];
    let binding = triangles.map(|_| "binding_0".to_owned());
    writeln!(writer, "ply\nformat binary_little_endian 1.0")?;
    if gaussians.antialiased {
        writeln!(writer, "{}", header::ANTIALIASED)?;
    }
    writeln!(writer, "element vertex {}", gaussians.len())?;
    for name in names.chain(last.map(String::from)).chain(binding) {
        writeln!(writer, "property float {name}")?;
    }
    writeln!(writer, "end_header")?;

    let mut values: Vec<f32> = Vec::with_capacity(18 + 3 * rest);
    for index in 0..gaussians.len() {
        let sh = &gaussians.sh[index * sh_len..][..sh_len];
        values.clear();
        values.extend(gaussians.positions[index].to_array());
        values.extend([0.0; 3]);
        values.extend(sh[0]);
        for channel in 0..3 {
            let given = sh[1..].iter().map(|coefficient| coefficient[channel]);
            values.extend(given.chain(std::iter::repeat(0.0)).take(rest));
        }
        values.push(logit(gaussians.opacities[index]));
        values.extend(gaussians.scales[index].to_array().map(log));
        let [x, y, z, w] = gaussians.rotations[index].to_array();
        values.extend([w, x, y, z]);
        values.extend(triangles.map(|triangles| triangles[index] as f32));
        for value in &values {
            writer.write_all(&value.to_le_bytes())?;
        }
    }
    Ok(())
}

fn log(scale: f32) -> f32 {
    if scale == 0.0 { RAW_ZERO as f32 } else { libm::log(f64::from(scale)) as f32 }
}

fn logit(opacity: f32) -> f32 {
    let opacity = f64::from(opacity);
    let raw = match opacity {
        0.0 => RAW_ZERO,
        1.0 => RAW_ONE,
        _ => libm::log(opacity / (1.0 - opacity)),
    };
    raw as f32
}

#[cfg(test)]
mod tests;
