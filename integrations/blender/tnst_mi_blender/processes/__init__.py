"""What runs beside Blender: jobs (`job`), and the environment in which tnst-mi is (`environment`)."""
