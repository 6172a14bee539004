//! Processes that `mpirun` or `srun` has started to train together.

use srflow_train::TrainError;
use srflow_train::ranks::{Alone, Communicator};

use crate::{Context, FAILED, fail};
#[cfg(not(feature = "mpi"))]
use srflow::wrong_settings;

/// The processes that train with this one: those that MPI knows, or none.
///
/// # Errors
/// When this program was built without MPI, or MPI does not know the processes.
pub fn start(mpi: bool) -> anyhow::Result<Box<dyn Communicator>> {
    if !mpi {
        return Ok(Box::new(Alone));
    }
    #[cfg(feature = "mpi")]
    return Ok(Box::new(srflow_train::mpi::World::start(|name| std::env::var(name).ok())?));
    #[cfg(not(feature = "mpi"))]
    wrong_settings!(
        "--mpi: this srflow was built without MPI; build it with --features mpi (docs/guides/train.md)"
    );
}

/// Ends all processes after an error, which the one that has it prints before any ends: launchers stop the others at the first that
/// fails.
pub fn exit_failed(communicator: Box<dyn Communicator>, error: &anyhow::Error, context: &Context) -> ! {
    let code = match error.downcast_ref() {
        Some(TrainError::OtherRank { .. }) => FAILED,
        Some(TrainError::Rank { .. }) => fail(error, context),
        // The others do not know of it, and would wait for this one.
        _ => communicator.abort(fail(error, context)),
    };
    drop(communicator);
    std::process::exit(code.into())
}
