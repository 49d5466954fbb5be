//! The programs of `examples/`: each asserts its own numbers.

#[path = "../../examples/certified_gain.rs"]
mod certified_gain;
#[path = "../../examples/fleet.rs"]
mod fleet;
#[path = "../../examples/kilohertz_loop.rs"]
mod kilohertz_loop;

#[test]
fn the_examples_end_well() {
    for program in [certified_gain::main, fleet::main, kilohertz_loop::main] {
        assert_eq!(program(), Ok(()));
    }
}
