//! SuperSplat's `.compressed.ply` (playcanvas/splat-transform, `src/lib/readers/decompress-ply.ts`): chunks of 256 Gaussians, of whose
//! positions, logarithms of scales and colours an element `chunk` has the limits; between them, an element `vertex` has 11, 10 and 11
//! bits of each, 8 bits of each colour and of opacity, and a quaternion without its largest part. An element `sh` may follow with a
//! byte for each further coefficient.

use std::io::Read;

use srflow_files::FileProblem;

use super::header::{Body, Element, Header};
use super::{Decoded, Layout};
use crate::files::{problem, room_for};
use crate::sh::SH_0;

/// Gaussians of a chunk.
const CHUNK: u64 = 256;
/// Lower and upper limits in `chunk`, in the order of [`Packed::numbers`].
const LIMITS: [[&str; 2]; 9] = [
    ["min_x", "max_x"],
    ["min_y", "max_y"],
    ["min_z", "max_z"],
    ["min_scale_x", "max_scale_x"],
    ["min_scale_y", "max_scale_y"],
    ["min_scale_z", "max_scale_z"],
    ["min_r", "max_r"],
    ["min_g", "max_g"],
    ["min_b", "max_b"],
];
/// Of a Gaussian in an uncompressed file, before its further coefficients.
const NAMES: [&str; 14] = [
    "x", "y", "z", "scale_0", "scale_1", "scale_2", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "rot_0",
    "rot_1", "rot_2", "rot_3",
];

/// The numbers of one Gaussian, as they are stored.
struct Packed {
    position: u32,
    rotation: u32,
    scale: u32,
    color: u32,
}

impl Packed {
    /// Position, scale and colour in 0..=1 between the limits of the chunk.
    fn numbers(&self) -> [f64; 9] {
        let of_32 = |bits: u32| [unorm(bits >> 21, 11), unorm(bits >> 11, 10), unorm(bits, 11)];
        let [x, y, z] = of_32(self.position);
        let [sx, sy, sz] = of_32(self.scale);
        let [r, g, b] = [24, 16, 8].map(|shift| unorm(self.color >> shift, 8));
        [x, y, z, sx, sy, sz, r, g, b]
    }

    fn opacity(&self) -> f64 {
        unorm(self.color, 8)
    }

    /// w, x, y, z: the upper two bits say which is left out, the largest.
    fn rotation(&self) -> [f64; 4] {
        let others =
            [20, 10, 0].map(|shift| (unorm(self.rotation >> shift, 10) - 0.5) * std::f64::consts::SQRT_2);
        let largest = (1.0 - others.iter().map(|part| part * part).sum::<f64>()).max(0.0).sqrt();
        let mut others = others.into_iter();
        let which = (self.rotation >> 30) as usize;
        std::array::from_fn(|at| if at == which { largest } else { others.next().unwrap_or_default() })
    }
}

/// The lowest bits as a number in 0..=1.
fn unorm(value: u32, bits: u32) -> f64 {
    let most = (1 << bits) - 1;
    f64::from(value & most) / f64::from(most)
}

/// Whose counts fit the size of the file.
pub(super) fn decode<R: Read>(header: &Header, mut body: Body<R>) -> Result<Decoded, FileProblem> {
    let (chunk, vertex, rest) = match &header.elements[..] {
        [chunk, vertex] => (chunk, vertex, None),
        [chunk, vertex, rest] if rest.name == "sh" => (chunk, vertex, Some(rest)),
        _ => return Err(unlike(header)),
    };
    let chunks = vertex.count.div_ceil(CHUNK);
    let lists = header.elements.iter().any(Element::has_lists);
    if chunk.name != "chunk" || vertex.name != "vertex" || chunk.count != chunks || lists {
        return Err(unlike(header));
    }
    if let Some(rest) = rest
        && rest.count != vertex.count
    {
        return Err(problem("sh", format!("{} rows, one for each Gaussian", vertex.count), rest.count));
    }
    let find = |element: &Element, name: &str| {
        let found = element.find(name);
        found.ok_or_else(|| problem("properties", format!("`{name}` of a compressed file"), "none"))
    };
    let colored = chunk.find("min_r").is_some();
    let mut limits = Vec::new();
    for [low, high] in &LIMITS[..if colored { 9 } else { 6 }] {
        limits.push([find(chunk, low)?, find(chunk, high)?]);
    }
    let packed = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];
    let [position, rotation, scale, color] = [0, 1, 2, 3].map(|at| find(vertex, packed[at]));
    let (position, rotation, scale, color) = (position?, rotation?, scale?, color?);

    let mut values = vec![0.0; chunk.properties.len()];
    let mut limits_of_chunks = Vec::new();
    for row in 0..chunk.count {
        body.row(chunk, row, &mut values)?;
        let of = |at: usize| limits.get(at).map_or([0.0, 1.0], |[low, high]| [values[*low], values[*high]]);
        limits_of_chunks.push(std::array::from_fn::<_, 9, _>(of));
    }
    let mut values = vec![0.0; vertex.properties.len()];
    let mut gaussians = Vec::new();
    for row in 0..vertex.count {
        body.row(vertex, row, &mut values)?;
        let get = |at: usize| values[at] as u32;
        gaussians.push(Packed {
            position: get(position),
            rotation: get(rotation),
            scale: get(scale),
            color: get(color),
        });
    }

    let coefficients = rest.map_or(0, |rest| rest.properties.len());
    let rest_names: Vec<String> = (0..coefficients).map(|number| format!("f_rest_{number}")).collect();
    let mut names = NAMES.to_vec();
    names.extend(rest_names.iter().map(String::as_str));
    let layout = Layout::of_names(&names, false)?;
    let order = match rest {
        Some(rest) => rest_names.iter().map(|name| find(rest, name)).collect::<Result<Vec<_>, _>>()?,
        None => Vec::new(),
    };
    let mut decoded = Decoded { gaussians: room_for(vertex.count, layout.sh_degree)?, ..Decoded::default() };
    decoded.gaussians.antialiased = header.antialiased;
    let mut bytes = vec![0.0; coefficients];
    let mut values = vec![0.0; names.len()];
    for (row, gaussian) in gaussians.iter().enumerate() {
        let limits = &limits_of_chunks[row / CHUNK as usize];
        for ((value, part), [low, high]) in values.iter_mut().zip(gaussian.numbers()).zip(limits) {
            *value = low * (1.0 - part) + high * part;
        }
        for color in &mut values[6..9] {
            *color = (*color - 0.5) / SH_0;
        }
        let opacity = gaussian.opacity();
        values[9] = (opacity / (1.0 - opacity)).ln();
        values[10..14].copy_from_slice(&gaussian.rotation());
        if let Some(rest) = rest {
            body.row(rest, row as u64, &mut bytes)?;
            for (value, &at) in values[14..].iter_mut().zip(&order) {
                *value = coefficient(bytes[at]);
            }
        }
        layout.push(&mut decoded, &values, row as u64)?;
    }
    body.end()?;
    Ok(decoded)
}

/// A coefficient in -4..=4 of its byte, in whose middle it is, except at both ends.
fn coefficient(byte: f64) -> f64 {
    let part = match byte {
        0.0 => 0.0,
        255.0 => 1.0,
        _ => (byte + 0.5) / 256.0,
    };
    (part - 0.5) * 8.0
}

fn unlike(header: &Header) -> FileProblem {
    let expected =
        "`chunk`, one row for each 256 of `vertex`, and maybe `sh`, as SuperSplat writes compressed files";
    problem("elements", expected, header.counts())
}
