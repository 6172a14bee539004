//! Tiles and scaling, for frames that are too large for memory or too slow.

use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

use crate::clap::Args;
use anyhow::Context as _;
use serde::{Deserialize, Serialize};
use srflow_core::{SettingError, Size};
use srflow_nets::{Padding, SMALLEST_TILE_SIDE, TileSize, Tiles, Tiling, scaled_size};

use crate::error::wrong_settings;
use crate::machine;
use crate::methods::Method;
use crate::networks::NetworkArgs;

/// The share of free memory that automatic tiles use: frames and flow need some beside the network.
const MEMORY_SHARE: f64 = 0.8;
/// Alignment of tiles for methods that need none.
const CLASSICAL_ALIGNMENT: usize = 8;

/// Options for large frames.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
#[command(next_help_heading = "Large frames")]
pub struct LargeFrames {
    /// Estimate tile by tile and blend the overlaps; `auto` uses the largest tiles that fit into free memory,
    /// or none if the whole frame fits
    #[arg(long, value_name = "WIDTHxHEIGHT|auto")]
    tile: Option<Tile>,
    /// Overlap of neighbouring tiles in pixels, up to half a tile
    #[arg(long, value_name = "PIXELS", default_value_t = Self::default().tile_overlap, requires = "tile", value_parser = overlap)]
    tile_overlap: usize,
    /// Resize the frames by this factor before estimation, and the flow back to full size
    #[arg(long, value_name = "FACTOR", value_parser = factor)]
    pub scale: Option<f64>,
}

impl Default for LargeFrames {
    fn default() -> Self {
        Self { tile: None, tile_overlap: 128, scale: None }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Tile {
    Size(Size),
    Auto,
}

/// Size of a method's input.
#[derive(Debug, Serialize, PartialEq)]
pub struct Resolution {
    /// Width and height after scaling.
    width: usize,
    height: usize,
    /// Of each tile; with a single tile, of the frame.
    pub tile_width: usize,
    pub tile_height: usize,
    tiles: usize,
}

const FACTORS: RangeInclusive<f64> = 1.0 / 64.0..=64.0;
const FACTOR: &str = "a factor from 1/64 to 64, such as 0.5";
const OVERLAPS: RangeInclusive<usize> = 8..=4096;
const OVERLAP: &str = "8 to 4096 pixels";

fn factor(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|factor| FACTORS.contains(factor)).ok_or_else(|| format!("expected {FACTOR}"))
}

fn overlap(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|pixels| OVERLAPS.contains(pixels)).ok_or_else(|| format!("expected {OVERLAP}"))
}

impl fmt::Display for Tile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Size(size) => size.fmt(f),
            Self::Auto => f.write_str("auto"),
        }
    }
}

srflow_core::serialize_as_text!(Tile);

impl FromStr for Tile {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" {
            return Ok(Self::Auto);
        }
        let size: Size = text.parse().map_err(|_| "expected WIDTHxHEIGHT in pixels, or auto".to_owned())?;
        if size.width.min(size.height) < SMALLEST_TILE_SIDE {
            return Err(format!("a tile needs at least {SMALLEST_TILE_SIDE} pixels a side"));
        }
        Ok(Self::Size(size))
    }
}

impl LargeFrames {
    /// Checks every value.
    ///
    /// # Errors
    /// Names the first that is out of range.
    pub fn check(&self) -> Result<(), SettingError> {
        let wrong =
            |field, found, expected: &str| SettingError { field, found, expected: expected.to_owned() };
        if !OVERLAPS.contains(&self.tile_overlap) {
            return Err(wrong("tile_overlap", self.tile_overlap.to_string(), OVERLAP));
        }
        match self.scale.filter(|scale| !FACTORS.contains(scale)) {
            Some(scale) => Err(wrong("scale", scale.to_string(), FACTOR)),
            None => Ok(()),
        }
    }

    /// Whether either option is set.
    pub fn given(&self) -> bool {
        self.tile.is_some() || self.scale.is_some()
    }

    /// The tiling; `None` for whole frames.
    ///
    /// # Errors
    /// When `auto` is requested and the free memory is unknown.
    pub fn tiling(&self, method: Method, network: &NetworkArgs) -> anyhow::Result<Option<Tiling>> {
        let alignment = match method {
            Method::Network(architecture) => network.init(architecture)?.padding(),
            _ => Padding::Fixed(CLASSICAL_ALIGNMENT),
        };
        let size = self.tile_size(method, network)?;
        Ok(size.map(|size| Tiling { size, overlap: self.tile_overlap, alignment }))
    }

    fn tile_size(&self, method: Method, network: &NetworkArgs) -> anyhow::Result<Option<TileSize>> {
        Ok(match (self.tile, method) {
            (None, _) => None,
            (Some(Tile::Size(size)), _) => Some(TileSize::Fixed(size)),
            (Some(Tile::Auto), Method::Network(architecture)) => {
                if !network.on_cpu() {
                    wrong_settings!(
                        "`tile` auto knows the memory of the machine, not of {}: give WIDTHxHEIGHT",
                        network.device
                    );
                }
                let free = machine::free_memory()
                    .context("`tile` auto: the free memory is not known; give WIDTHxHEIGHT")?;
                let need = architecture.facts().memory.of_batch(network.batch);
                Some(TileSize::Fitting { need, bytes: (free as f64 * MEMORY_SHARE) as u64 })
            }
            (Some(Tile::Auto), _) => {
                wrong_settings!(
                    "`tile` auto is for networks: give {} WIDTHxHEIGHT, or leave it out",
                    method.name()
                )
            }
        })
    }

    /// The input size for frames of `size`.
    ///
    /// # Errors
    /// As [`LargeFrames::tiling`], and when the memory is too small for any tile.
    pub fn resolution(
        &self,
        size: Size,
        method: Method,
        network: &NetworkArgs,
    ) -> anyhow::Result<Resolution> {
        let size = self.scale.map_or(size, |factor| scaled_size(size, factor));
        let (tile, tiles) = match self.tiling(method, network)? {
            Some(tiling) => {
                let tiles = Tiles::new(size, tiling)?;
                (tiles.size(), tiles.count())
            }
            None => (size, 1),
        };
        let Size { width, height } = size;
        Ok(Resolution { width, height, tile_width: tile.width, tile_height: tile.height, tiles })
    }
}
