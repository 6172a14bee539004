use std::fmt;
use std::str::FromStr;

use srflow_simd::{DeviceError, DeviceName};

use crate::{Camera, Frame, Gaussians, Next, Options, RasterizeError, Rasterizer};

#[cfg(all(feature = "cube", not(any(feature = "cuda", feature = "vulkan"))))]
compile_error!("the feature `cube` is the common part of `cuda` and `vulkan`: turn on one of these");

/// What rasterizes: the CPU, or a GPU that the build supports.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Device {
    kind: &'static str,
    /// Its number among those of its kind.
    number: usize,
    #[cfg(feature = "cube")]
    pub(crate) gpu: Option<cubecl::Device>,
}

impl Device {
    /// The CPU.
    pub fn cpu() -> Self {
        Self {
            kind: "cpu",
            number: 0,
            #[cfg(feature = "cube")]
            gpu: None,
        }
    }

    /// A device of this machine: `cpu`, `cuda` or `vulkan`, or one of several as `cuda:1`; by default the first. Vulkan's devices are
    /// ordered discrete, integrated, virtual, software.
    ///
    /// # Errors
    /// When the name is unknown, the build does not support the kind, or the machine has no such device.
    pub fn named(name: &str) -> Result<Self, DeviceError> {
        let name = DeviceName::parse(name)?;
        #[cfg(feature = "cube")]
        {
            let devices = match name.kind {
                #[cfg(feature = "cuda")]
                "cuda" => cuda_devices(),
                #[cfg(feature = "vulkan")]
                "vulkan" => vulkan_devices(),
                _ => return name.pick(vec![Self::cpu()]),
            };
            let kind = name.kind;
            let devices = devices.into_iter().zip(0..);
            name.pick(devices.map(|(device, number)| Self { kind, number, gpu: Some(device) }).collect())
        }
        #[cfg(not(feature = "cube"))]
        name.pick(vec![Self::cpu()])
    }

    /// The devices of a kind on this machine: how each is called here, and what its driver calls it.
    pub fn all(kind: &'static str) -> Vec<(String, String)> {
        let name = |number: usize| if number == 0 { kind.to_owned() } else { format!("{kind}:{number}") };
        let names = (0..).map(name);
        names.map_while(|name| Self::named(&name).ok().map(|device| (name, device.name()))).collect()
    }

    /// What its driver calls it.
    pub fn name(&self) -> String {
        #[cfg(feature = "cube")]
        if let Some(gpu) = &self.gpu {
            return gpu.client().properties().identity.name.clone();
        }
        "processor".to_owned()
    }

    pub fn is_cpu(&self) -> bool {
        self.kind == "cpu"
    }

    /// `cpu`, `cuda` or `vulkan`.
    pub fn kind(&self) -> &'static str {
        self.kind
    }
}

impl fmt::Display for Device {
    /// As [`Device::named`] reads it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.number {
            0 => f.pad(self.kind),
            number => write!(f, "{}:{number}", self.kind),
        }
    }
}

impl FromStr for Device {
    type Err = DeviceError;

    fn from_str(name: &str) -> Result<Self, DeviceError> {
        Self::named(name)
    }
}

srflow_core::serialize_as_text!(Device);

#[cfg(feature = "cuda")]
fn cuda_devices() -> Vec<cubecl::Device> {
    let all = cubecl::Device::enumerate_all().into_iter();
    all.filter(|device| device.runtime() == cubecl::RuntimeId::Cuda).collect()
}

/// Those of Vulkan alone: left to choose, CubeCL takes OpenGL where Vulkan has no driver or software only. In the order in which Burn
/// numbers them.
#[cfg(feature = "vulkan")]
fn vulkan_devices() -> Vec<cubecl::Device> {
    use cubecl::device::WgpuDeviceKind::{Cpu, DiscreteGpu, IntegratedGpu, Other, VirtualGpu};
    let numbered =
        |kind: fn(usize) -> _| (0..).map_while(move |number| cubecl::Device::vulkan(kind(number)).ok());
    let software = cubecl::Device::vulkan(Cpu).ok();
    let gpus = numbered(DiscreteGpu).chain(numbered(IntegratedGpu)).chain(numbered(VirtualGpu));
    gpus.chain(software).chain(numbered(Other)).collect()
}

/// Rasterizes on a [`Device`]. Unlike those of a [`Rasterizer`], its renderings cannot be differentiated.
pub struct DeviceRasterizer(Kind);

enum Kind {
    Cpu(Box<Rasterizer>),
    #[cfg(feature = "cube")]
    Gpu(crate::gpu::GpuRasterizer),
}

impl Default for DeviceRasterizer {
    /// On the CPU.
    fn default() -> Self {
        Self(Kind::Cpu(Box::default()))
    }
}

impl DeviceRasterizer {
    /// A rasterizer on `device`.
    #[cfg_attr(not(feature = "cube"), expect(unused_variables, reason = "there is one device"))]
    pub fn new(device: &Device) -> Self {
        #[cfg(feature = "cube")]
        if let Some(gpu) = &device.gpu {
            return Self(Kind::Gpu(crate::gpu::GpuRasterizer::new(gpu)));
        }
        Self::default()
    }

    /// [`Rasterizer::render`]. On a GPU the outputs differ in rounding: the tests hold colours within 2/255, the flow within 0.01 px
    /// and depths within 1e-3 of [`mod@crate::reference`], as on the CPU.
    ///
    /// # Errors
    /// As there; and on a GPU when Gaussians are to be sorted per pixel, or when the driver fails.
    pub fn render(
        &mut self,
        gaussians: &Gaussians,
        camera: &Camera,
        next: Option<Next<'_>>,
        options: &Options,
        frame: &mut Frame,
    ) -> Result<(), RasterizeError> {
        match &mut self.0 {
            Kind::Cpu(cpu) => cpu.render(gaussians, camera, next, options, frame).map(drop),
            #[cfg(feature = "cube")]
            Kind::Gpu(gpu) => gpu.render(gaussians, camera, next, options, frame),
        }
    }
}
