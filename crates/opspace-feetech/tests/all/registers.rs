//! Registers: signs, ranges and addresses.

use opspace_feetech::protocol::{Access, REGISTERS, Register};
use proptest::prelude::*;

#[test]
fn registers_do_not_overlap_and_are_sorted() {
    for pair in REGISTERS.windows(2) {
        assert!(pair[0].address + pair[0].width <= pair[1].address, "{} {}", pair[0].name, pair[1].name);
    }
}

/// Bytes computed by hand from Feetech's description of the sign bits.
#[test]
fn signs_are_magnitudes_with_a_sign_bit() {
    assert_eq!(Register::PRESENT_POSITION.decode(&[0x18, 0x85]), Some(-0x518));
    assert_eq!(Register::PRESENT_LOAD.decode(&[0x2C, 0x05]), Some(-300));
    assert_eq!(Register::HOMING_OFFSET.encode(-5).expect("in range"), [0x05, 0x08]);
    assert_eq!(Register::MAX_POSITION_LIMIT.decode(&[0xFF, 0x0F]), Some(4095));
    assert_eq!(Register::P_COEFFICIENT.decode(&[]), None);
    assert_eq!(Register::PRESENT_VOLTAGE.decode_in(&[0, 0, 0, 0, 0, 0, 74], 56), Some(74));
    assert_eq!(Register::P_COEFFICIENT.decode_in(&[1, 2], 56), None);
}

#[test]
fn a_value_out_of_range_names_the_register_and_its_range() {
    let error = Register::P_COEFFICIENT.encode(256).expect_err("one byte");
    assert_eq!(error.to_string(), "register P_Coefficient takes 0 to 255, not 256");
    let error = Register::HOMING_OFFSET.encode(-2048).expect_err("eleven bits");
    assert_eq!(error.to_string(), "register Homing_Offset takes -2047 to 2047, not -2048");
}

#[test]
fn names_find_their_registers() {
    assert_eq!(Register::named("Torque_Enable").map(|register| register.access), Some(Access::Volatile));
    assert_eq!(Register::named("Torque"), None);
}

proptest! {
    /// Compares a value with the same value, written and read.
    #[test]
    fn values_return(index in 0..REGISTERS.len(), share in 0.0..=1.0_f64) {
        let register = &REGISTERS[index];
        let (min, max) = register.range();
        let value = min + (share * f64::from(max - min)).round() as i32;
        let bytes = register.encode(value).expect("in range");
        prop_assert_eq!(register.decode(&bytes), Some(value));
    }
}
