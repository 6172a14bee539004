//! Ranks that MPI has started, with `mpirun` or `srun`.

use mpi::Threading;
use mpi::datatype::{Partition, PartitionMut};
use mpi::environment::{Universe, initialize_with_threading, library_version};
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator as _, CommunicatorCollectives as _};

use crate::ranks::Communicator;

/// Variables by which launchers give a process the number of processes.
const SIZES: [(&str, &str); 3] = [
    ("OMPI_COMM_WORLD_SIZE", "mpirun of Open MPI"),
    ("PMI_SIZE", "mpiexec of MPICH, Intel MPI or MVAPICH, or srun"),
    ("SLURM_STEP_NUM_TASKS", "srun"),
];

/// A launcher of several processes, and how many it has started.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Launched {
    launcher: &'static str,
    processes: usize,
}

/// The launcher that has started this process as one of several, by the variables of its environment.
fn launched(variable: impl Fn(&str) -> Option<String>) -> Option<Launched> {
    SIZES.iter().find_map(|&(name, launcher)| {
        let processes = variable(name)?.parse().ok()?;
        (processes > 1).then_some(Launched { launcher, processes })
    })
}

/// All processes of an MPI program. Errors of MPI, such as a process that is lost, end them all.
pub struct World {
    world: SimpleCommunicator,
    /// Ends MPI when it is dropped, so after `world`.
    _universe: Universe,
}

/// MPI cannot be started.
#[derive(Debug, thiserror::Error)]
pub enum MpiError {
    #[error("MPI was started before in this process, which it allows only once")]
    Again,
    #[error(
        "expected {expected} processes, since the environment has the variables of {launcher}; found {found} with {library}. Start \
         srflow with the mpirun of the MPI that it was built with, or with srun --mpi=pmix or --mpi=pmi2"
    )]
    Processes { expected: usize, found: usize, launcher: &'static str, library: String },
}

impl World {
    /// Starts MPI, in which there must be as many processes as the launcher says by the variables of the environment.
    ///
    /// # Errors
    /// When MPI was started before, or does not know the launcher.
    pub fn start(variable: impl Fn(&str) -> Option<String>) -> Result<Self, MpiError> {
        // Only this thread calls MPI.
        let (universe, _) = initialize_with_threading(Threading::Funneled).ok_or(MpiError::Again)?;
        let world = Self { world: universe.world(), _universe: universe };
        let found = world.ranks();
        match launched(variable) {
            Some(Launched { launcher, processes: expected }) if expected != found => {
                let library = library_version().unwrap_or_default();
                let library = library.lines().next().unwrap_or("an unknown MPI").trim().to_owned();
                Err(MpiError::Processes { expected, found, launcher, library })
            }
            _ => Ok(world),
        }
    }
}

impl Drop for World {
    fn drop(&mut self) {
        if std::thread::panicking() {
            // The others would wait for this process.
            self.abort(1);
        }
    }
}

impl Communicator for World {
    fn rank(&self) -> usize {
        usize::try_from(self.world.rank()).expect("ranks count from 0")
    }

    fn ranks(&self) -> usize {
        usize::try_from(self.world.size()).expect("a positive number of processes")
    }

    fn all_gather(&self, mine: &[u8]) -> Vec<Vec<u8>> {
        let mut sizes = vec![0; self.ranks()];
        self.world.all_gather_into(&count(mine.len()), &mut sizes[..]);
        let starts = starts(&sizes);
        let mut all = room(&sizes);
        let mut parts = PartitionMut::new(&mut all[..], &sizes[..], &starts[..]);
        self.world.all_gather_varcount_into(somewhere(mine), &mut parts);
        split(&all, &sizes)
    }

    fn all_to_all(&self, parts: &[&[u8]]) -> Vec<Vec<u8>> {
        let sent: Vec<i32> = parts.iter().map(|part| count(part.len())).collect();
        let mut received = vec![0; sent.len()];
        self.world.all_to_all_into(&sent[..], &mut received[..]);
        let (from, to) = (starts(&sent), starts(&received));
        let joined = parts.concat();
        let mut all = room(&received);
        let outgoing = Partition::new(somewhere(&joined), &sent[..], &from[..]);
        let mut incoming = PartitionMut::new(&mut all[..], &received[..], &to[..]);
        self.world.all_to_all_varcount_into(&outgoing, &mut incoming);
        split(&all, &received)
    }

    fn abort(&self, exit_code: u8) -> ! {
        self.world.abort(exit_code.into())
    }
}

/// MPI counts with 32 bits: 2 GiB in a message, which is 500 million parameters of a network.
fn count(bytes: usize) -> i32 {
    i32::try_from(bytes).expect("a message of less than 2 GiB")
}

fn starts(sizes: &[i32]) -> Vec<i32> {
    let place = |end: &mut i32, size: &i32| {
        let start = *end;
        *end = end.checked_add(*size).expect("messages of less than 2 GiB");
        Some(start)
    };
    sizes.iter().scan(0, place).collect()
}

/// A buffer for parts of these sizes, with an address even if they are empty; see [`somewhere`].
fn room(sizes: &[i32]) -> Vec<u8> {
    let bytes = sizes.iter().map(|&size| usize::try_from(size).expect("a size")).sum::<usize>();
    let mut room = Vec::with_capacity(bytes.max(1));
    room.resize(bytes, 0);
    room
}

/// The same bytes; none are at an address of their own. Rust's address for no bytes is 1, by which Open MPI means `MPI_IN_PLACE`.
fn somewhere(bytes: &[u8]) -> &[u8] {
    static BYTE: [u8; 1] = [0];
    if bytes.is_empty() { &BYTE[..0] } else { bytes }
}

fn split(mut bytes: &[u8], sizes: &[i32]) -> Vec<Vec<u8>> {
    let mut parts = Vec::with_capacity(sizes.len());
    for &size in sizes {
        let (part, rest) = bytes.split_at(usize::try_from(size).expect("a size"));
        parts.push(part.to_vec());
        bytes = rest;
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn launchers_are_known_by_their_variables() {
        let with = |variables: &[(&str, &str)]| {
            launched(|name| {
                variables.iter().find(|(known, _)| *known == name).map(|(_, value)| (*value).to_owned())
            })
        };
        assert_eq!(with(&[]), None);
        assert_eq!(with(&[("OMPI_COMM_WORLD_SIZE", "1"), ("PMI_SIZE", "x")]), None);
        assert_eq!(with(&[("PMI_SIZE", "8")]).map(|launched| launched.processes), Some(8));
        // A batch script of Slurm has the number of the job's tasks, and is one process.
        assert_eq!(with(&[("SLURM_NTASKS", "4")]), None);
        let launched = with(&[("SLURM_STEP_NUM_TASKS", "4")]).unwrap();
        assert_eq!(launched, Launched { launcher: "srun", processes: 4 });
    }
}
