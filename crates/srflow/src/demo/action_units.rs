//! Every action unit of a head: the face at rest, at full intensity, and the flow between the two.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use srflow_avatar::{Avatar, PosedHead};
use srflow_core::{Image, Size, flow_colors};
use srflow_head::{HeadPose, Side, unit_name};
use srflow_render::generate::{Rig, View};
use srflow_report::html::{ActionCard, Picture};
use srflow_report::{flow_scale, shrink_flow, shrink_image};
use srflow_splat::{Camera, Frame, Gaussians, Next, Options, Outputs, Rasterizer};

/// Size of the rendering and width of the picture on the page: Gaussians far smaller than a pixel look thick, so the
/// rendering is larger and downscaled.
const RENDERED: Size = Size::new(640, 760);
const SHOWN_WIDTH: usize = 280;

/// How many times closer than the rig the camera is.
const ZOOM: f64 = 2.1;

/// One card per action unit of the avatar's head, both halves of the face together.
///
/// # Errors
/// When a picture cannot be rendered or encoded.
pub fn cards(avatar: &Avatar, background: [u8; 3]) -> anyhow::Result<Vec<ActionCard>> {
    let (mut head, mut rest) = (PosedHead::default(), Gaussians::default());
    avatar.gaussians_into(&HeadPose::default(), &mut head, &mut rest);
    let rest_vertices = head.vertices().to_vec();
    let studio = || (Studio::before(avatar, background), PosedHead::default(), Gaussians::default());
    let at_rest = Picture::jpeg(&studio().0.photograph(&rest)?, "the face at rest")?;

    let mut numbers: Vec<u8> = avatar.model().action_units.iter().map(|unit| unit.number).collect();
    numbers.sort_unstable();
    numbers.dedup();
    let card = |(studio, head, full): &mut (Studio, PosedHead, Gaussians), number: u8| {
        let pose = avatar.model().pose_of_action_units(&[(number, Side::Both, 1.0)])?;
        avatar.gaussians_into(&pose, head, full);
        let furthest = furthest_millimetres(&rest_vertices, head.vertices());
        let name = unit_name(number).unwrap_or("");
        let alt = format!("action unit {number}, {name}");
        Ok(ActionCard {
            title: format!("AU {number}"),
            note: format!("{name}, up to {furthest:.1} mm"),
            rest: at_rest.clone(),
            full: Picture::jpeg(&studio.photograph(full)?, &alt)?,
            flow: Picture::jpeg(&studio.flow(&rest, full)?, &format!("flow of {alt}"))?,
        })
    };
    numbers.into_par_iter().map_init(studio, card).collect()
}

/// One camera that looks at a face, and its rasterizer.
struct Studio {
    camera: Camera,
    options: Options,
    rasterizer: Rasterizer,
    frame: Frame,
}

impl Studio {
    fn before(avatar: &Avatar, background: [u8; 3]) -> Self {
        let mut camera = Rig::new(RENDERED, face_centre(avatar)).camera(View::default());
        camera.fx *= ZOOM;
        camera.fy *= ZOOM;
        let background = background.map(|channel| f32::from(channel) / 255.0);
        let options = Options { background, ..Options::default() };
        Self { camera, options, rasterizer: Rasterizer::new(), frame: Frame::new() }
    }

    fn photograph(&mut self, gaussians: &Gaussians) -> anyhow::Result<Image> {
        let options = Options { outputs: Outputs::IMAGE, ..self.options };
        self.rasterizer.render(gaussians, &self.camera, None, &options, &mut self.frame)?;
        Ok(shrink_image(&self.frame.image, SHOWN_WIDTH))
    }

    /// Flow from one set to the other, in colours with full strength near its longest.
    fn flow(&mut self, from: &Gaussians, to: &Gaussians) -> anyhow::Result<Image> {
        let outputs = Outputs { flow: true, ..Outputs::IMAGE };
        let options = Options { outputs, ..self.options };
        let next = Next { gaussians: to, camera: &self.camera };
        self.rasterizer.render(from, &self.camera, Some(next), &options, &mut self.frame)?;
        let flow = shrink_flow(&self.frame.flow, SHOWN_WIDTH);
        Ok(flow_colors(&flow, Some(flow_scale(&flow) as f32)))
    }
}

/// Centre of the facial landmarks at rest, metres; the origin for a head without landmarks.
fn face_centre(avatar: &Avatar) -> DVec3 {
    let places = avatar.model().landmarks_on(&avatar.shaped().vertices);
    places.map(|place| place.as_dvec3()).sum::<DVec3>() / avatar.model().landmarks.len().max(1) as f64
}

/// The largest displacement of any vertex, in millimetres.
fn furthest_millimetres(from: &[Vec3], to: &[Vec3]) -> f32 {
    1e3 * from.iter().zip(to).map(|(from, to)| from.distance(*to)).fold(0.0, f32::max)
}
