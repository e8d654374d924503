"""What a document describes: its nodes, meshes, colours, skins and their bind pose, and what VRM adds."""
