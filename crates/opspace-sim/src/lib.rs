//! A simulated arm: rigid bodies, actuators, multirate servo, sensors and surroundings.
