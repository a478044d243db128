"""Where the sensor was: recorded, estimated from the scans, or recorded and refined; and when each point was seen."""
