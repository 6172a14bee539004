/// Why a set of Gaussians cannot be rendered.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RasterizeError {
    /// A list of a set of Gaussians has another length than its list of positions asks for.
    #[error("{set}: {list} holds {found} entries, {expected} Gaussians need {needed}")]
    ListLength {
        /// `the Gaussians` or `the next Gaussians`.
        set: &'static str,
        /// Name of the field, e.g. `opacities`.
        list: &'static str,
        /// Number of positions.
        expected: usize,
        /// Entries that this number needs.
        needed: usize,
        /// Entries there are.
        found: usize,
    },
    /// The spherical harmonics are of a degree that the rasterizer does not know.
    #[error("spherical harmonics of degree {0}: degrees 0 to 3 are known")]
    ShDegree(usize),
    /// The two sets are not in correspondence.
    #[error("the two sets must correspond Gaussian by Gaussian: the first holds {first}, the next {next}")]
    CountMismatch {
        /// Gaussians in the first set.
        first: usize,
        /// Gaussians in the next set.
        next: usize,
    },
    /// The two cameras' images differ in size.
    #[error("the two cameras' images differ in size: {}x{} and {}x{} (WIDTHxHEIGHT); flow needs one size", .first.0, .first.1, .next.0, .next.1)]
    SizeMismatch {
        /// Width and height of the first camera's image.
        first: (usize, usize),
        /// Width and height of the next camera's image.
        next: (usize, usize),
    },
    /// A camera cannot be rendered with.
    #[error(transparent)]
    Camera(#[from] CameraError),
}

/// What is wrong with a [`Camera`](crate::Camera).
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// No pixel.
    #[error("the image is {width}x{height} (WIDTHxHEIGHT): both must be at least 1")]
    Empty {
        /// Width in pixels.
        width: usize,
        /// Height in pixels.
        height: usize,
    },
    /// More pixels than [`MAX_PIXELS`](crate::MAX_PIXELS).
    #[error(
        "the image is {width}x{height} (WIDTHxHEIGHT): at most {} pixels a side and {} in all can be rendered; render it \
         in parts by moving the principal point",
        crate::MAX_SIDE,
        crate::MAX_PIXELS
    )]
    TooLarge {
        /// Width in pixels.
        width: usize,
        /// Height in pixels.
        height: usize,
    },
    /// A focal length that is not a positive finite number.
    #[error("{name} is {value}: a focal length must be positive and finite")]
    FocalLength {
        /// `fx` or `fy`.
        name: &'static str,
        /// Its value in pixels.
        value: f64,
    },
    /// A principal point that is not finite.
    #[error("the principal point is ({cx}, {cy}): both must be finite")]
    PrincipalPoint {
        /// Column in pixels.
        cx: f64,
        /// Row in pixels.
        cy: f64,
    },
    /// A pose that is not a rotation and a translation.
    #[error("camera from world is not a rigid motion: {0}")]
    NotRigid(String),
}
