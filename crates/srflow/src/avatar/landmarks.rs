//! The landmarks of a mesh, found in pictures of it.

use std::fmt;
use std::path::PathBuf;

use anyhow::{Context as _, bail};
use glam::{DMat3, DVec2, DVec3, Vec3};
use serde::{Deserialize, Serialize};
use srflow_avatar::{HeadSource, SurfacePoint, visible_surface};
use srflow_core::{Image, Size};
use srflow_face::{Face, FaceBox, FaceFinder};
use srflow_files::{write_file, write_image_png};
use srflow_head::{Region, vertex_normals};
use srflow_splat::Camera;

use super::mesh::default_seed;
use crate::clap::Args;
use crate::face::{FaceModels, draw_points};
use crate::output::{ensure_extension, ensure_free, write_line};
use crate::{Job, Report, Watch};

/// Find the 68 landmarks of a head model without any
///
/// Renders the mesh and finds the face in the picture with MediaPipe's networks. Place the file beside the model as
/// landmarks_68.txt: the head can then be dressed with Gaussians and fitted.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = "Example:
  srflow avatar landmarks --model gltf:scan.glb -o landmarks_68.txt --viz landmarks.png

docs/guides/faces.md says where to get the networks. Check the picture: the points must be on brows, eyes, nose, lips and jaw.")]
pub struct LandmarksJob {
    /// Head model
    #[arg(long, value_name = "KIND:PATH", help = crate::render::head_help())]
    pub model: HeadSource,
    /// Seed of a built-in head
    #[arg(long, value_name = "N", default_value_t = default_seed())]
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// File to write: 68 rows in dlib's order, each with three vertices and their weights
    #[arg(short, long, value_name = "TXT")]
    pub out: PathBuf,
    /// Draw the landmarks into the picture of the mesh
    #[arg(long, value_name = "PNG")]
    #[serde(default)]
    pub viz: Option<PathBuf>,
    /// Overwrite existing files
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
    #[command(flatten)]
    #[serde(flatten)]
    pub models: FaceModels,
}

/// Side of the pictures, pixels.
const SIDE: usize = 768;

/// The head takes so much of the picture.
const SHARE: f64 = 0.62;

/// Shares of a mesh that are looked at, from above: all of it, and the head of a standing person.
const UPPER: [f64; 2] = [1.0, 0.15];

/// A landmark is at most so many pixels from where the network sees it, unless there is nothing.
const NEAR: f64 = 10.0;

/// Pixels that one pixel of depth counts as.
const BEHIND: f64 = 0.3;

/// Heads are looked at from all sides, and lying ones from above: the axis that they face, and the one that is up.
const FACING: [[DVec3; 2]; 8] = [
    [DVec3::Z, DVec3::Y],
    [DVec3::NEG_Z, DVec3::Y],
    [DVec3::X, DVec3::Y],
    [DVec3::NEG_X, DVec3::Y],
    [DVec3::NEG_Y, DVec3::Z],
    [DVec3::Y, DVec3::Z],
    [DVec3::X, DVec3::Z],
    [DVec3::NEG_X, DVec3::Z],
];

impl Job for LandmarksJob {
    const NAME: &'static str = "avatar landmarks";

    type Report = LandmarksReport;

    fn work(&self, _watch: &Watch) -> anyhow::Result<LandmarksReport> {
        ensure_extension(&self.out, "txt")?;
        self.viz.as_ref().map_or(Ok(()), |viz| ensure_extension(viz, "png"))?;
        ensure_free([Some(&self.out), self.viz.as_ref()].into_iter().flatten(), self.force)?;
        let model = self.model.model(self.seed).with_context(|| format!("reading {}", self.model))?;
        let finder = FaceFinder::read(&self.models.path()?)?;
        let (surface, triangles) = model.surface(&model.template);
        // Hair and glasses would hide the face.
        let is_face = |triangle: &u32| model.regions[*triangle as usize] != Region::Clear;
        let numbers: Vec<u32> = (0..triangles.len() as u32).filter(is_face).collect();
        let triangles: Vec<[u32; 3]> = numbers.iter().map(|number| triangles[*number as usize]).collect();
        let color = |point: &SurfacePoint| model.color_at(numbers[point.triangle], point.weights.as_vec3());
        let Some(seen) = SeenMesh::best(surface, &triangles, &color, &finder)? else {
            bail!(
                "{}: no face was found in pictures of the mesh from all sides; list the landmarks by hand",
                self.model
            );
        };
        let rows = seen.rows(&triangles);
        write_file(&self.out, rows)?;
        if let Some(viz) = &self.viz {
            write_image_png(viz, &draw_points(&seen.picture, seen.landmarks()))?;
        }
        let [x, y, z] = seen.facing.to_array();
        Ok(LandmarksReport { out: self.out.clone(), score: seen.face.score, facing: [x, y, z] })
    }
}

/// A mesh in which a face was found.
struct SeenMesh {
    /// Nearest points of its pixels.
    points: Vec<Option<SurfacePoint>>,
    /// Pixels of the picture for each unit of depth: from so far away, it is the same for all of the mesh.
    pixels_per_unit: f64,
    picture: Image,
    face: Face,
    facing: DVec3,
}

impl SeenMesh {
    /// From the side where the mesh shows most of a face.
    fn best(
        vertices: &[Vec3],
        triangles: &[[u32; 3]],
        color: &impl Fn(&SurfacePoint) -> Option<Vec3>,
        finder: &FaceFinder,
    ) -> anyhow::Result<Option<Self>> {
        let normals = vertex_normals(vertices, triangles);
        let centre =
            vertices.iter().map(|vertex| vertex.as_dvec3()).sum::<DVec3>() / vertices.len().max(1) as f64;
        let look = |camera: &Camera, [facing, up]: [DVec3; 2]| -> anyhow::Result<Option<Self>> {
            let points = visible_surface(vertices, triangles, camera);
            let picture = lit(&points, triangles, &normals, color, facing, up);
            let face = finder.faces(&picture)?.into_iter().max_by(|a, b| a.score.total_cmp(&b.score));
            let pixels_per_unit = camera.fx / camera.position().distance(centre);
            Ok(face.map(|face| Self { points, pixels_per_unit, picture, face, facing }))
        };
        let mut best: Option<(Self, Camera, [DVec3; 2])> = None;
        for share in UPPER {
            for axes in FACING {
                let camera = in_front(&upper(vertices, axes[1], share), axes);
                if let Some(seen) = look(&camera, axes)?
                    && best.as_ref().is_none_or(|(best, ..)| seen.frontality() > best.frontality())
                {
                    best = Some((seen, camera, axes));
                }
            }
            if best.is_some() {
                break;
            }
        }
        let Some((far, camera, axes)) = best else { return Ok(None) };
        // Once more, closer.
        Ok(Some(look(&closer(camera, far.face.bounds(Size::new(SIDE, SIDE))), axes)?.unwrap_or(far)))
    }

    /// How surely and how much from the front a face is seen: the detector is as sure of profiles, where the eyes are close together.
    fn frontality(&self) -> f64 {
        let between = |a: usize, b: usize| {
            let place =
                |number: usize| self.landmarks().get(number).map_or(DVec2::ZERO, |p| DVec2::from_array(*p));
            place(a).distance(place(b))
        };
        f64::from(self.face.score) * between(36, 45) / between(27, 8).max(f64::MIN_POSITIVE)
    }

    /// The 68 landmarks, pixels.
    fn landmarks(&self) -> &[[f64; 2]] {
        self.face.points.dlib.as_deref().map_or(&[], |points| points)
    }

    /// The rows of the file.
    fn rows(&self, triangles: &[[u32; 3]]) -> String {
        let row = |landmark: &[f64; 2]| {
            self.on_surface(landmark).map_or_else(
                String::new,
                |SurfacePoint { triangle, weights, .. }| {
                    let corners = triangles[triangle].iter().zip(weights.to_array());
                    let cells: Vec<String> =
                        corners.map(|(vertex, weight)| format!("{vertex} {weight:.4}")).collect();
                    cells.join(" ") + "\n"
                },
            )
        };
        self.landmarks().iter().map(row).collect()
    }

    /// The point of the surface at a landmark. A few pixels count as much as lying behind: between the lips, a landmark is not in
    /// the throat, and beside the jaw not on the neck.
    fn on_surface(&self, [x, y]: &[f64; 2]) -> Option<SurfacePoint> {
        let away = |pixel: usize| {
            let (column, row) = ((pixel % SIDE) as f64, (pixel / SIDE) as f64);
            (column - x).powi(2) + (row - y).powi(2)
        };
        let shown = || self.points.iter().enumerate().filter_map(|(pixel, point)| Some((pixel, (*point)?)));
        let near: Vec<(usize, SurfacePoint)> =
            shown().filter(|(pixel, _)| away(*pixel) < NEAR * NEAR).collect();
        let front = near.iter().map(|(_, point)| point.depth).fold(f64::INFINITY, f64::min);
        let behind = |point: &SurfacePoint| BEHIND * self.pixels_per_unit * (point.depth - front);
        let cost = |(pixel, point): &(usize, SurfacePoint)| away(*pixel) + behind(point).powi(2);
        let best = near.iter().copied().min_by(|a, b| cost(a).total_cmp(&cost(b)));
        best.or_else(|| shown().min_by(|(a, _), (b, _)| away(*a).total_cmp(&away(*b))))
            .map(|(_, point)| point)
    }
}

/// The vertices in the upper share of a mesh's height.
fn upper(vertices: &[Vec3], up: DVec3, share: f64) -> Vec<Vec3> {
    let height = |vertex: &Vec3| vertex.as_dvec3().dot(up);
    let top = vertices.iter().map(height).fold(f64::NEG_INFINITY, f64::max);
    let bottom = vertices.iter().map(height).fold(f64::INFINITY, f64::min);
    vertices.iter().filter(|vertex| height(vertex) >= top - share * (top - bottom)).copied().collect()
}

/// A camera that sees the whole of a mesh from where it faces, from far away.
fn in_front(vertices: &[Vec3], [facing, up]: [DVec3; 2]) -> Camera {
    let right = up.cross(facing);
    let along = |axis: DVec3| {
        let all = || vertices.iter().map(|vertex| vertex.as_dvec3().dot(axis));
        [all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max)]
    };
    let [across, down, deep] = [right, up, facing].map(along);
    let middle = |[low, high]: [f64; 2]| (low + high) / 2.0;
    let extent = (across[1] - across[0]).max(down[1] - down[0]).max(1e-9);
    let distance = 6.0 * extent;
    let centre = right * middle(across) + up * middle(down);
    let position = centre + facing * (deep[1] + distance);
    // Cameras look along z, with y down.
    let world_from_camera = DMat3::from_cols(right, -up, -facing);
    let focal = SHARE * SIDE as f64 * distance / extent;
    Camera::centred(Size::new(SIDE, SIDE), [focal; 2]).placed(world_from_camera, position)
}

/// The camera, with a face in this box filling its picture.
fn closer(camera: Camera, face: FaceBox) -> Camera {
    let scale = SHARE * SIDE as f64 / face.width.max(face.height) as f64;
    let moved = |axis: f64, start: usize, len: usize| {
        (axis - (start as f64 + len as f64 / 2.0)) * scale + SIDE as f64 / 2.0
    };
    Camera {
        fx: camera.fx * scale,
        fy: camera.fy * scale,
        cx: moved(camera.cx, face.left, face.width),
        cy: moved(camera.cy, face.top, face.height),
        ..camera
    }
}

/// The mesh in its own colours, else those of skin, lit from above the camera.
fn lit(
    points: &[Option<SurfacePoint>],
    triangles: &[[u32; 3]],
    normals: &[Vec3],
    color: impl Fn(&SurfacePoint) -> Option<Vec3>,
    facing: DVec3,
    up: DVec3,
) -> Image {
    const SKIN: Vec3 = Vec3::new(0.878, 0.675, 0.58);
    const BEHIND: [u8; 3] = [96, 104, 112];
    let light = (facing + 0.6 * up).normalize();
    Image::from_fn(SIDE, SIDE, |x, y| {
        let Some(point) = points[y * SIDE + x] else { return BEHIND };
        let SurfacePoint { triangle, weights, .. } = point;
        let corners = triangles[triangle].iter().zip(weights.to_array());
        let normal: DVec3 =
            corners.map(|(vertex, weight)| normals[*vertex as usize].as_dvec3() * weight).sum();
        let shade = 0.3 + 0.7 * normal.normalize_or_zero().dot(light).max(0.0);
        let color = color(&point).unwrap_or(SKIN).as_dvec3() * (255.0 * shade);
        color.to_array().map(|level| level.round() as u8)
    })
}

/// The file that [`LandmarksJob`] wrote.
#[derive(Debug, Clone, Serialize)]
pub struct LandmarksReport {
    pub out: PathBuf,
    /// How sure the detector is of the face, 0.5 to 1.
    pub score: f32,
    /// The direction that the head faces in the model's file.
    pub facing: [f64; 3],
}

impl Report for LandmarksReport {}

impl fmt::Display for LandmarksReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write_line(f, format_args!("{}: 68 landmarks of a face, score {:.2}", self.out.display(), self.score))
    }
}
