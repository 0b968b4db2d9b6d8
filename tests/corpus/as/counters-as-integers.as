; @ variables are 32-bit integers: exact where a real is not, with another one.
; after: @total = 16777217
; after: real = 16777216
; after: @cut = 3
; after: half = 3.5
.PROGRAM main()
  @total=16777216
  @one=1
  @total=@total+@one
  real=16777216
  real=real+1
  @cut=3.9
  half=@total MOD 10/2
  @seven=7
  half=@seven/2
.END
