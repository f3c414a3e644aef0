"""The flexible-joint model: body, joints and effects; states and rates."""
