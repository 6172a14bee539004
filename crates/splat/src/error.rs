use srflow_core::Size;

/// Why a set of Gaussians cannot be rendered.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RasterizeError {
    /// The length of a list does not match the number of positions.
    #[error("{set}: {list} has {found} entries, {expected} Gaussians need {needed}")]
    ListLength {
        /// `the Gaussians` or `the next Gaussians`.
        set: &'static str,
        /// Name of the field, e.g. `opacities`.
        list: &'static str,
        /// Number of positions.
        expected: usize,
        /// Entries needed.
        needed: usize,
        /// Entries found.
        found: usize,
    },
    /// The degree of the spherical harmonics is not supported.
    #[error("spherical harmonics of degree {0}: degrees 0 to 3 are supported")]
    ShDegree(usize),
    /// The two sets do not correspond.
    #[error("the two sets must correspond Gaussian by Gaussian: the first has {first}, the next {next}")]
    CountMismatch {
        /// Gaussians in the first set.
        first: usize,
        /// Gaussians in the next set.
        next: usize,
    },
    /// The two cameras' images differ in size.
    #[error("the two cameras' images differ in size: {first} and {next} (WIDTHxHEIGHT); flow needs one size")]
    SizeMismatch {
        /// Of the first camera's image.
        first: Size,
        /// Of the next camera's image.
        next: Size,
    },
    /// A list of gradients does not fit the rendered image.
    #[error(
        "the gradients: {list} has {found} entries, an image of {size} (WIDTHxHEIGHT) needs {} or none",
        .size.pixels()
    )]
    GradientLength {
        /// Name of the field, e.g. `color`.
        list: &'static str,
        /// Entries found.
        found: usize,
        /// Size of the image.
        size: Size,
    },
    /// [`Sorting::PerPixel`](crate::Sorting::PerPixel) on another device than the CPU.
    #[error("Gaussians are sorted per pixel on the CPU only: use the device cpu, or global sorting")]
    SortingOnDevice,
    /// The device's driver failed.
    #[error("the device failed: {0}; use the device cpu, or smaller images if its memory is too small")]
    Device(String),
    /// A camera cannot be rendered.
    #[error(transparent)]
    Camera(#[from] CameraError),
}

/// Why a [`Camera`](crate::Camera) cannot be rendered.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// The image is empty.
    #[error("the image is {size} (WIDTHxHEIGHT): both must be at least 1")]
    Empty { size: Size },
    /// The image is larger than [`MAX_PIXELS`](crate::MAX_PIXELS) or [`MAX_SIDE`](crate::MAX_SIDE).
    #[error(
        "the image is {size} (WIDTHxHEIGHT): at most {} pixels a side and {} in all can be rendered; render it \
         in parts by moving the principal point",
        crate::MAX_SIDE,
        crate::MAX_PIXELS
    )]
    TooLarge { size: Size },
    /// A focal length is not positive and finite.
    #[error("{name} is {value}: a focal length must be positive and finite")]
    FocalLength {
        /// `fx` or `fy`.
        name: &'static str,
        /// In pixels.
        value: f64,
    },
    /// The principal point is not finite.
    #[error("the principal point is ({cx}, {cy}): both must be finite")]
    PrincipalPoint {
        /// Column in pixels.
        cx: f64,
        /// Row in pixels.
        cy: f64,
    },
    /// The pose is not a rotation and a translation.
    #[error("camera from world is not a rigid motion: {0}")]
    NotRigid(String),
}
