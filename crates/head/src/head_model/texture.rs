use glam::Vec2;

/// Where the triangles of a head model are in a picture of its skin.
///
/// Points are not vertices: where the picture has a seam, a vertex has several.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TextureMap {
    /// From (0, 0) at the lower left corner of the picture to (1, 1) at the upper right one, as in OBJ.
    pub points: Vec<Vec2>,
    /// The points at the corners of each triangle of the model.
    pub triangles: Vec<[u32; 3]>,
}
