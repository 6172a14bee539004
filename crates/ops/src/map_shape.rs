/// Sizes of feature maps, `[batch, channels, height, width]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MapShape {
    /// Images.
    pub batch: usize,
    /// Planes of each image.
    pub channels: usize,
    /// Rows of each plane.
    pub height: usize,
    /// Columns of each plane.
    pub width: usize,
}

impl MapShape {
    /// `[batch, channels, height, width]`.
    pub fn dims(&self) -> [usize; 4] {
        [self.batch, self.channels, self.height, self.width]
    }

    /// Elements of a plane.
    pub fn pixels(&self) -> usize {
        self.height * self.width
    }

    /// Planes of all images.
    pub fn planes(&self) -> usize {
        self.batch * self.channels
    }

    /// Elements of all planes.
    pub fn elements(&self) -> usize {
        self.planes() * self.pixels()
    }

    /// Of other channels.
    pub fn with_channels(self, channels: usize) -> Self {
        Self { channels, ..self }
    }
}

impl From<[usize; 4]> for MapShape {
    fn from([batch, channels, height, width]: [usize; 4]) -> Self {
        Self { batch, channels, height, width }
    }
}
