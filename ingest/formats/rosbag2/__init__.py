"""ROS 2 bags: SQLite, read page by page."""
