//! Every operation of a save fails once, or is the last before a crash.

use std::cell::{Cell, RefCell};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use super::super::disk::write_synced;
use super::*;
use crate::Error;
use crate::storage::{Fault, Loaded, load, save};

#[derive(Clone, Copy, PartialEq)]
enum Trouble {
    /// Every operation works.
    None,
    /// One operation fails and later ones work, so that clean-up runs.
    Once(i32),
    /// No later operation changes the disk, as after a kill or a crash.
    Crash,
}

thread_local! {
    /// The operations that were done.
    static DONE: RefCell<Vec<&'static str>> = const { RefCell::new(Vec::new()) };
    static TROUBLE: Cell<(Trouble, u32)> = const { Cell::new((Trouble::None, 0)) };
}

const EPERM: i32 = 1;
const EIO: i32 = 5;
const ENOSPC: i32 = 28;

/// Called by every operation that changes the disk, before it does anything.
pub(in crate::storage) fn disk_point(action: &'static str) -> io::Result<()> {
    TROUBLE.with(|cell| match cell.get() {
        (Trouble::None, _) => {
            DONE.with_borrow_mut(|done| done.push(action));
            Ok(())
        }
        (trouble, left) if left > 0 => {
            cell.set((trouble, left - 1));
            Ok(())
        }
        (Trouble::Once(code), _) => {
            cell.set((Trouble::None, 0));
            Err(io::Error::from_raw_os_error(code))
        }
        (Trouble::Crash, _) => Err(io::Error::from_raw_os_error(EIO)),
    })
}

/// Runs `work` with trouble at operation number `at`; returns whether that was reached.
fn with<T>(trouble: Trouble, at: u32, work: impl FnOnce() -> T) -> (T, bool) {
    TROUBLE.set((trouble, at));
    let result = work();
    let (now, left) = TROUBLE.replace((Trouble::None, 0));
    (result, now != trouble || (trouble == Trouble::Crash && left == 0))
}

/// An empty directory that is removed afterwards.
struct Room(PathBuf);

impl Room {
    fn new() -> Self {
        static SERIAL: AtomicU32 = AtomicU32::new(0);
        let name = format!("stochens-storage-{}-{}", std::process::id(), SERIAL.fetch_add(1, Ordering::Relaxed));
        let path = std::env::temp_dir().join(name);
        fs::create_dir(&path).unwrap();
        Self(path)
    }

    fn state(&self) -> PathBuf {
        self.0.join("state")
    }

    fn names(&self) -> Vec<String> {
        let mut names: Vec<_> =
            fs::read_dir(&self.0).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }
}

impl Drop for Room {
    fn drop(&mut self) {
        fs::remove_dir_all(&self.0).unwrap();
    }
}

/// Content that identifies the generation.
fn put(path: &Path, generation: u64) -> crate::Result<u64> {
    let values = vec![generation as f64; 100];
    save(path, "test", &[section("g", Values::Reals(values.into()))], &go())
}

fn get(path: &Path) -> crate::Result<Loaded> {
    load(path, "test", &go())
}

/// The generation that is loaded, after a check of its content.
fn generation(path: &Path) -> u64 {
    let loaded = get(path).unwrap().container;
    assert_eq!(reals(&loaded, "g"), [loaded.generation as f64; 100]);
    loaded.generation
}

fn damage(path: &Path) {
    let mut bytes = fs::read(path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 4;
    fs::write(path, bytes).unwrap();
}

#[test]
fn generations_follow_each_other_and_one_is_kept() {
    let room = Room::new();
    let state = room.state();
    for g in 1..=3 {
        assert_eq!(put(&state, g).unwrap(), g);
        assert_eq!(generation(&state), g);
        assert!(get(&state).unwrap().recovered.is_none());
    }
    assert_eq!(room.names(), ["state", "state.lock", "state.prev"]);
    assert_eq!(generation(&room.0.join("state.prev")), 2);
    assert_eq!(fs::metadata(room.0.join("state.lock")).unwrap().len(), 0);
}

/// The order of operations: nothing gets its final name before it is synced, and a save returns only after the
/// directory is.
#[test]
fn the_order_of_operations() {
    let room = Room::new();
    put(&room.state(), 1).unwrap();
    DONE.take();
    put(&room.state(), 2).unwrap();
    let keep = ["link", "rename", "remove"]; // the last for a name that a rename between equal files leaves
    let expected = [&["open", "create", "write", "sync"], &keep[..], &["rename", "sync the directory", "remove"]];
    assert_eq!(DONE.take(), expected.concat());
}

/// For 0, 1 and 2 earlier generations: the k-th operation fails or crashes, for every k.
#[test]
fn trouble_at_every_operation_loses_nothing() {
    for before in 0..=2u64 {
        for trouble in [Trouble::Once(EIO), Trouble::Once(ENOSPC), Trouble::Once(EPERM), Trouble::Crash] {
            for at in 0.. {
                let room = Room::new();
                let state = room.state();
                (1..=before).for_each(|g| assert_eq!(put(&state, g).unwrap(), g));
                let (result, reached) = with(trouble, at, || put(&state, before + 1));
                if !reached {
                    assert!(result.is_ok() && at >= 5, "{at}");
                    break;
                }
                let names = room.names();
                let leftover = names.iter().filter(|name| name.ends_with(".tmp")).count();
                if trouble == Trouble::Crash {
                    // after the last necessary operation, only clean-up can crash
                    assert!(leftover <= 2);
                } else {
                    assert_eq!(leftover, 0, "{names:?}");
                }
                match (&result, before) {
                    (Ok(g), _) => assert_eq!(*g, before + 1),
                    (Err(error), _) if !matches!(error, Error::Os { code: Some(_), .. }) => panic!("{error:?}"),
                    (Err(_), 0) => match get(&state) {
                        // nothing had been saved before: nothing, or the new state whose directory was not synced
                        Ok(found) => assert_eq!(found.container.generation, 1),
                        Err(error) => assert!(matches!(error, Error::Os { action: "open", .. }), "{error:?}"),
                    },
                    (Err(_), g) => assert!((g..=g + 1).contains(&generation(&state))),
                }
                if result.is_ok() {
                    assert_eq!(generation(&state), before + 1);
                }
                // the next save works, increments the generation, keeps a previous one and removes temporary files
                let last = get(&state).map_or(0, |found| found.container.generation);
                assert_eq!(put(&state, last + 1).unwrap(), last + 1);
                assert_eq!(generation(&state), last + 1);
                if last > 0 {
                    assert_eq!(generation(&room.0.join("state.prev")), last);
                }
                assert!(room.names().iter().all(|name| !name.ends_with(".tmp")), "{:?}", room.names());
            }
        }
    }
}

/// Both names point to one file after a crash behind step 4; then renaming one over the other does nothing.
#[test]
fn two_names_of_one_generation() {
    let room = Room::new();
    let state = room.state();
    put(&state, 1).unwrap();
    fs::hard_link(&state, room.0.join("state.prev")).unwrap();
    assert_eq!(put(&state, 2).unwrap(), 2);
    assert_eq!(generation(&room.0.join("state.prev")), 1);
    assert_eq!(room.names(), ["state", "state.lock", "state.prev"]);
}

#[test]
fn without_hard_links_the_state_is_renamed() {
    let room = Room::new();
    let state = room.state();
    (1..=2).for_each(|g| assert_eq!(put(&state, g).unwrap(), g));
    let refusals = (0..20).filter(|&at| {
        let last = generation(&state);
        let (result, reached) = with(Trouble::Once(EPERM), at, || put(&state, last + 1));
        // a failed link is no error: the result is as after any other save
        let linked = result.is_ok() && reached;
        assert!(!linked || generation(&room.0.join("state.prev")) == last);
        linked
    });
    // the link itself, and the removal of the temporaries' names that are gone
    assert_eq!(refusals.count(), 3);
}

#[test]
fn a_damaged_state_is_recovered_and_does_not_replace_the_good_one() {
    let room = Room::new();
    let (state, prev) = (room.state(), room.0.join("state.prev"));
    (1..=3).for_each(|g| assert_eq!(put(&state, g).unwrap(), g));
    for breakage in [damage as fn(&Path), |path| fs::write(path, b"").unwrap(), |path| fs::remove_file(path).unwrap()] {
        breakage(&state);
        let loaded = get(&state).unwrap();
        assert_eq!((loaded.container.generation, loaded.container.source), (2, prev.clone()));
        assert!(loaded.recovered.is_some());
        assert_eq!(put(&state, 3).unwrap(), 3);
        assert_eq!((generation(&state), generation(&prev)), (3, 2));
    }
    // a flipped bit at the beginning makes a foreign file, but the previous generation shows that a state was here
    let mut bytes = fs::read(&state).unwrap();
    bytes[8] ^= 1;
    fs::write(&state, bytes).unwrap();
    assert_eq!(generation(&state), 2);
    assert_eq!(put(&state, 3).unwrap(), 3);
    // both damaged: nothing can be loaded, and the message names both
    damage(&state);
    damage(&prev);
    let message = get(&state).unwrap_err().to_string();
    assert!(message.contains("state\" is damaged") && message.contains("state.prev\" is damaged"), "{message}");
    assert_eq!(put(&state, 1).unwrap(), 1);
}

/// Every truncation and every flipped bit again, on the disk and with a previous generation.
#[test]
fn every_damage_is_recovered() {
    let room = Room::new();
    let state = room.state();
    let small = |value: f64| {
        save(&state, "test", &[section("g", Values::Reals(vec![value].into()))], &go()).unwrap();
    };
    small(1.0);
    small(2.0);
    let good = fs::read(&state).unwrap();
    let mut broken: Vec<Vec<u8>> = (0..good.len()).map(|len| good[..len].to_vec()).collect();
    broken.extend((0..good.len() * 8).map(|bit| {
        let mut bytes = good.clone();
        bytes[bit / 8] ^= 1 << (bit % 8);
        bytes
    }));
    assert_eq!(broken.len(), 9 * 232);
    for bytes in broken {
        fs::write(&state, bytes).unwrap();
        let loaded = get(&state).unwrap();
        assert!(matches!(loaded.recovered, Some(Error::State { .. })));
        assert_eq!(reals(&loaded.container, "g"), [1.0]);
    }
}

#[test]
fn nothing_but_a_state_of_this_kind_is_replaced() {
    let room = Room::new();
    let state = room.state();
    let refused = |expected: &str| {
        fs::write(room.0.join("state.lock"), "").unwrap();
        let before = (fs::read(room.state()).ok(), room.names());
        let error = put(&room.state(), 1).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
        assert_eq!((fs::read(room.state()).ok(), room.names()), before);
    };
    fs::write(&state, "Dear diary").unwrap();
    refused("not a state file");
    fs::remove_file(&state).unwrap();
    save(&state, "other", &[], &go()).unwrap();
    refused("kind 'other'");
    fs::remove_file(&state).unwrap();
    fs::create_dir(&state).unwrap();
    refused("is a directory");
    fs::remove_dir(&state).unwrap();
    #[cfg(unix)]
    {
        fs::write(room.0.join("target"), "x").unwrap();
        std::os::unix::fs::symlink(room.0.join("target"), &state).unwrap();
        refused("is a symbolic link");
    }
    for name in ["a.prev", "a.lock", "a.tmp", ".."] {
        assert!(matches!(put(&room.0.join(name), 1), Err(Error::Value { name: "path", .. })), "{name}");
    }
}

#[test]
fn a_second_writer_is_told() {
    let room = Room::new();
    let state = room.state();
    put(&state, 1).unwrap();
    let lock = fs::File::open(room.0.join("state.lock")).unwrap();
    lock.lock().unwrap();
    assert_eq!(put(&state, 2), Err(Error::Locked { path: state.clone() }));
    assert_eq!(generation(&state), 1); // readers need no lock
    lock.unlock().unwrap();
    assert_eq!(put(&state, 2).unwrap(), 2);
    // several saves under one lock, which ends with its object
    let held = crate::storage::lock(&state).unwrap();
    assert_eq!(put(&state, 3), Err(Error::Locked { path: state.clone() }));
    for next in 3..5 {
        assert_eq!(crate::storage::save_held(&held, &state, "test", &[], &go()), Ok(next));
    }
    drop(held);
    assert_eq!(put(&state, 5).unwrap(), 5);
}

#[test]
#[cfg(unix)]
fn permissions_stay() {
    use std::os::unix::fs::PermissionsExt;
    let room = Room::new();
    let state = room.state();
    put(&state, 1).unwrap();
    fs::set_permissions(&state, fs::Permissions::from_mode(0o640)).unwrap();
    put(&state, 2).unwrap();
    assert_eq!(fs::metadata(&state).unwrap().permissions().mode() & 0o777, 0o640);
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_device_is_an_error_with_its_number() {
    let mut full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let error = write_synced(&mut full, Path::new("/dev/full"), &[1; 10], &go()).unwrap_err();
    assert!(matches!(error, Error::Os { action: "write", code: Some(ENOSPC), .. }), "{error:?}");
    assert_eq!(error.to_string(), "cannot write \"/dev/full\": no space left on device");
}

#[test]
fn a_stop_leaves_the_old_state() {
    let room = Room::new();
    let state = room.state();
    put(&state, 1).unwrap();
    let stop = go();
    stop.request();
    assert_eq!(save(&state, "test", &[], &stop), Err(Error::Interrupted));
    assert_eq!(load(&state, "test", &stop), Err(Error::Interrupted));
    assert_eq!(generation(&state), 1);
    assert_eq!(room.names(), ["state", "state.lock"]);
}

#[test]
fn special_files_and_lost_states() {
    #[cfg(unix)]
    assert!(matches!(get(Path::new("/dev/null")), Err(Error::State { fault: Fault::NotRegular { .. }, .. })));
    let room = Room::new();
    assert!(matches!(get(&room.state()), Err(Error::Os { action: "open", code: Some(2), .. })));
    fs::write(room.0.join("state.prev"), "text").unwrap();
    assert!(matches!(get(&room.state()), Err(Error::State { fault: Fault::Foreign, .. })));
    assert!(matches!(get(&room.0.join("none.prev")), Err(Error::Os { code: Some(2), .. })));
}
