//! Files of 3D Gaussians: a table with one line per format. Each format is one file in this folder.

mod glb;
mod ksplat;
mod ply;
mod sog;
mod splat;
mod spz;

use std::ffi::OsStr;
use std::fmt;
use std::path::Path;
use std::str::FromStr;

use glam::{DMat3, DMat4, DQuat, Quat, Vec3};
use srflow_files::{FileError, FileProblem};

use crate::{Gaussians, HalfTurn, sh};

pub use ply::{parse_ply, read_bound_ply, read_ply, write_bound_ply, write_ply};

type Write = fn(&Path, &Gaussians) -> Result<(), FileError>;

/// A format of files of 3D Gaussians.
#[derive(Debug)]
pub struct SplatFormat {
    /// Ending of the file's name, in lower case.
    pub extension: &'static str,
    /// The direction that is up in its files; `None` where the format leaves it to the scene.
    pub up: Option<Up>,
    /// How programs turn its files to others in which down is up.
    half_turn: HalfTurn,
    /// Whether the Gaussians keep their order, so that those of two files correspond.
    pub keeps_order: bool,
    /// What is lost on writing, for a note; `None` where every value is kept.
    pub loses: Option<&'static str>,
    read: fn(&Path) -> Result<Gaussians, FileError>,
    /// `None` for formats that are read only.
    write: Option<Write>,
}

/// The direction that is up in the world of Gaussians.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Up {
    /// +y, as of the heads of this project and in glTF: x right, y up, z towards the viewer.
    #[default]
    PlusY,
    /// -y, as of most scenes that were reconstructed from photographs: x right, y down, z away from the viewer.
    MinusY,
}

impl fmt::Display for Up {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::PlusY => "y",
            Self::MinusY => "-y",
        })
    }
}

impl FromStr for Up {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "y" | "+y" => Ok(Self::PlusY),
            "-y" => Ok(Self::MinusY),
            _ => Err("expected y or -y".to_owned()),
        }
    }
}

srflow_core::serialize_as_text!(Up);

/// The formats. The first is that of files with any other extension.
pub static SPLAT_FORMATS: [SplatFormat; 6] = [
    SplatFormat {
        extension: "ply",
        up: None,
        half_turn: HalfTurn::X,
        keeps_order: true,
        loses: None,
        read: ply::read_ply,
        write: Some(ply::write_ply),
    },
    SplatFormat {
        extension: "splat",
        up: Some(Up::MinusY),
        half_turn: HalfTurn::X,
        keeps_order: false,
        loses: Some(
            "the order of the Gaussians, spherical harmonics above degree 0 and whether they are antialiased; \
             colours, opacities and rotations are rounded to 8 bits",
        ),
        read: splat::read,
        write: Some(splat::write),
    },
    SplatFormat {
        extension: "spz",
        up: Some(Up::PlusY),
        half_turn: HalfTurn::X,
        keeps_order: true,
        loses: Some("precision: scales are rounded to steps of 6 %, spherical harmonics to 4 or 5 bits"),
        read: spz::read,
        write: Some(spz::write),
    },
    SplatFormat {
        extension: "glb",
        up: Some(Up::PlusY),
        half_turn: HalfTurn::Z,
        keeps_order: true,
        loses: None,
        read: glb::read,
        write: Some(glb::write),
    },
    SplatFormat {
        extension: "ksplat",
        up: None,
        half_turn: HalfTurn::X,
        keeps_order: false,
        loses: None,
        read: ksplat::read,
        write: None,
    },
    SplatFormat {
        extension: "sog",
        up: None,
        half_turn: HalfTurn::X,
        keeps_order: false,
        loses: None,
        read: sog::read,
        write: None,
    },
];

impl SplatFormat {
    /// The format of a file's extension, in any case; `None` for an unknown one.
    pub fn of(path: &Path) -> Option<&'static Self> {
        let extension = path.extension().and_then(OsStr::to_str)?;
        SPLAT_FORMATS.iter().find(|format| format.extension.eq_ignore_ascii_case(extension))
    }

    /// The turn that keeps Gaussians upright between this format, in which `up` is up, and another. It is that of the format with +y up:
    /// splat-transform turns `.ply` to `.glb` about z (`Transform.PLY`), Niantic's library to `.spz` about x.
    pub fn turn_to(&self, up: Up, to: &Self, to_up: Up) -> Option<HalfTurn> {
        match (up, to_up) {
            (Up::PlusY, Up::MinusY) => Some(self.half_turn),
            (Up::MinusY, Up::PlusY) => Some(to.half_turn),
            _ => None,
        }
    }

    /// Whether it is also written.
    pub fn is_written(&self) -> bool {
        self.write.is_some()
    }

    /// All extensions, for messages: `.ply, .splat, .spz, .glb, .ksplat, .sog`.
    pub fn extensions() -> String {
        Self::listed(|_| true)
    }

    /// Those that are also written.
    pub fn written_extensions() -> String {
        Self::listed(Self::is_written)
    }

    fn listed(shown: fn(&Self) -> bool) -> String {
        let shown = SPLAT_FORMATS.iter().filter(|format| shown(format));
        shown.map(|format| format!(".{}", format.extension)).collect::<Vec<_>>().join(", ")
    }
}

/// Reads 3D Gaussians in the format of the file's extension, in the coordinates of the file; a file with another extension is read as
/// a PLY, which names itself in its first line.
///
/// # Errors
/// When the file cannot be read, is not of that format, is shorter or longer than its header claims, or contains a value that is
/// not finite, a negative scale or a rotation that is none; the error names the Gaussian.
pub fn read_gaussians(path: &Path) -> Result<Gaussians, FileError> {
    let format = SplatFormat::of(path).unwrap_or(&SPLAT_FORMATS[0]);
    (format.read)(path)
}

/// Writes 3D Gaussians in the format of the file's extension, in their own coordinates, whole or not at all.
///
/// # Errors
/// When the extension is unknown, the lists do not match, a value has no form in the file (not finite, a negative scale, an opacity
/// outside 0..=1, a position out of range), or the file cannot be written.
pub fn write_gaussians(path: &Path, gaussians: &Gaussians) -> Result<(), FileError> {
    let write = SplatFormat::of(path).and_then(|format| format.write).ok_or_else(|| {
        let found = path.extension().unwrap_or_default().to_string_lossy().into_owned();
        problem("extension", SplatFormat::written_extensions(), found).in_file(path)
    })?;
    write(path, gaussians)
}

fn problem(field: &'static str, expected: impl ToString, found: impl ToString) -> FileProblem {
    FileProblem::Field { field, expected: expected.to_string(), found: found.to_string() }
}

/// Empty lists with memory for `count` Gaussians, which must have been compared with the size of the file.
fn room_for(count: u64, sh_degree: usize) -> Result<Gaussians, FileProblem> {
    let mut gaussians = Gaussians { sh_degree, ..Gaussians::default() };
    let reserve = |gaussians: &mut Gaussians| {
        let count = usize::try_from(count).ok()?;
        let sh = count.checked_mul(gaussians.sh_len())?;
        gaussians.positions.try_reserve_exact(count).ok()?;
        gaussians.scales.try_reserve_exact(count).ok()?;
        gaussians.rotations.try_reserve_exact(count).ok()?;
        gaussians.opacities.try_reserve_exact(count).ok()?;
        gaussians.sh.try_reserve_exact(sh).ok()
    };
    match reserve(&mut gaussians) {
        Some(()) => Ok(gaussians),
        None => Err(problem("number of Gaussians", "memory for them", count)),
    }
}

/// Gaussians of a file with numbers that are not finite.
#[derive(Debug, Default)]
struct Invisible(usize);

impl Invisible {
    /// Appends one. It keeps its place, so that those of two files correspond, and lies where the one before is, so that the
    /// extent of the scene stays.
    fn push(&mut self, to: &mut Gaussians) {
        to.positions.push(to.positions.last().copied().unwrap_or_default());
        to.scales.push(Vec3::ZERO);
        to.rotations.push(Quat::IDENTITY);
        to.opacities.push(0.0);
        to.sh.extend(std::iter::repeat_n([0.0; 3], to.sh_len()));
        self.0 += 1;
    }

    /// Notes their number, if there are any.
    fn note(&self, path: &Path, all: &Gaussians) {
        if self.0 > 0 {
            let (path, all) = (path.display(), all.len());
            log::warn!("{path}: {} of {all} Gaussians hold no numbers and are invisible", self.0);
        }
    }
}

/// How much axes may differ in length, and from right angles.
const TOLERANCE: f64 = 1e-4;

/// Moves Gaussians to other coordinates; `to_from_own` may mirror them.
fn place(gaussians: &mut Gaussians, to_from_own: DMat4) -> Result<(), FileProblem> {
    if to_from_own == DMat4::IDENTITY {
        return Ok(());
    }
    let axes = DMat3::from_mat4(to_from_own);
    let scale = axes.x_axis.length();
    let axes = axes * (1.0 / scale);
    let apart = axes.transpose() * axes - DMat3::IDENTITY;
    if !apart.to_cols_array().iter().all(|entry| entry.abs() <= TOLERANCE) {
        let expected =
            "a rotation, a translation and one scale for all axes, which keep the Gaussians' shapes";
        return Err(problem("coordinates", expected, "other axes"));
    }
    for position in &mut gaussians.positions {
        *position = to_from_own.transform_point3(position.as_dvec3()).as_vec3();
    }
    for size in &mut gaussians.scales {
        *size = (size.as_dvec3() * scale).as_vec3();
    }
    // A mirror image is one along z, turned.
    let mut turn = axes;
    if axes.determinant() < 0.0 {
        turn.z_axis = -turn.z_axis;
        for own in &mut gaussians.rotations {
            *own = Quat::from_xyzw(-own.x, -own.y, own.z, own.w);
        }
        sh::mirror_z(gaussians.sh_degree, &mut gaussians.sh);
    }
    let turn = DQuat::from_mat3(&turn).normalize();
    for own in &mut gaussians.rotations {
        *own = (turn * own.as_dquat()).normalize().as_quat();
    }
    sh::rotate(gaussians.sh_degree, &mut gaussians.sh, DMat3::from_quat(turn));
    let finite = gaussians.positions.iter().chain(&gaussians.scales).all(|vector| vector.is_finite());
    if finite { Ok(()) } else { Err(problem("coordinates", "Gaussians at finite positions", "others")) }
}

/// Checks what every writer relies on.
fn check(gaussians: &Gaussians) -> Result<(), FileProblem> {
    gaussians
        .validate("the Gaussians")
        .map_err(|error| problem("lists", "lists of matching lengths", error))?;
    (0..gaussians.len()).try_for_each(|index| check_one(gaussians, index))
}

fn check_one(gaussians: &Gaussians, index: usize) -> Result<(), FileProblem> {
    let sh_len = gaussians.sh_len();
    let check = |field, holds: bool, expected: &str, value: &dyn std::fmt::Debug| {
        if holds { Ok(()) } else { Err(problem(field, expected, format!("{value:?} of Gaussian {index}"))) }
    };
    let (position, scale) = (gaussians.positions[index], gaussians.scales[index]);
    let (rotation, opacity) = (gaussians.rotations[index], gaussians.opacities[index]);
    let sh = &gaussians.sh[index * sh_len..][..sh_len];
    check("position", position.is_finite(), "finite numbers", &position)?;
    let lengths = scale.is_finite() && scale.cmpge(Vec3::ZERO).all();
    check("scale", lengths, "finite lengths, not negative", &scale)?;
    check(
        "rotation",
        rotation.is_finite() && rotation != Quat::from_array([0.0; 4]),
        "a quaternion",
        &rotation,
    )?;
    check("opacity", (0.0..=1.0).contains(&opacity), "0 to 1", &opacity)?;
    check("spherical harmonics", sh.as_flattened().iter().all(|c| c.is_finite()), "finite numbers", &sh)
}

/// The quaternion of length 1, or an error that names the Gaussian.
fn unit_rotation(rotation: [f64; 4], index: usize) -> Result<Quat, FileProblem> {
    let length = rotation.iter().map(|part| part * part).sum::<f64>().sqrt();
    if length > 0.0 && length.is_finite() {
        return Ok(Quat::from_array(rotation.map(|part| (part / length) as f32)));
    }
    let found = if length == 0.0 { "zero" } else { "one that is not finite" };
    Err(problem("rotation", "a quaternion that is not zero", format!("{found} of Gaussian {index}")))
}

#[cfg(test)]
mod tests;
