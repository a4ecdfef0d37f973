"""What containers carry: ROS, protobuf and JSON messages, their definitions and decoders."""
