;;; Curves along motions (motion_reading.lisp), as points between which straight lines may be drawn.
;;;
;;; More points are taken where the curve bends, at the ends of the parts on which it is real, and at poles.  A curve
;;; that goes to infinity is drawn as far as its other values make sense of it, as box plots have it.
;;;
;;; Entry points: $anmech_drawing_times, $anmech_drawn_curve.

(in-package :anmech)
(needs "algebra/terms" "numerics/dag" "numerics/evaluation" "numerics/integration" "numerics/motion"
       "numerics/motion_reading")

;;; Times

(defun step-times (motion)
  "The times between the steps, from the first to the last at which the motion is given."
  (let* ((reached (motion-reached motion))
         (forward (>= reached (start-time motion))))
    (append (remove-if (lambda (time) (if forward (>= time reached) (<= time reached)))
                       (coerce (integration-times (motion-integration motion)) 'list))
            (list reached))))

(defun thinned (list most)
  "About MOST elements of LIST, at equal distances, and the last one."
  (let ((stride (ceiling (length list) most)))
    (append (loop for element in (butlast list)
                  for place from 0
                  when (zerop (mod place stride)) collect element)
            (last list))))

(defun drawing-times (motion least most)
  (let* ((times (thinned (step-times motion) most))
         (parts (ceiling least (max 1 (1- (length times))))))
    (append (loop for (start end) on times
                  while end
                  append (loop for part from 0 below parts
                               collect (+ start (* (/ part (float parts 1d0)) (- end start)))))
            (last times))))

(maxima::defmfun maxima::$anmech_drawing_times (motion least most)
  "anmech_drawing_times(record, least, most): from LEAST to MOST times, about, between which a motion may be drawn
straight.  Steps are short where much happens, so each of them is divided alike."
  (numbers-list (drawing-times motion least most)))

;;; Points: lists of numbers, nil where the curve has no real values

(defun points-at (motion reader times)
  (flet ((double (number) (if (floatp number) number (to-double number))))
    (mapcar (lambda (row) (and (every #'finite-p row) (mapcar #'double row)))
            (rows-with-holes motion reader times))))

(defun values-of (points place)
  (loop for point in points when point collect (nth place point)))

(defstruct extent
  "Of one coordinate, as its first points show it: the median, a quarter above and below, and how far it goes."
  lower median upper width)

(defun extent-of (numbers)
  (let ((sorted (sort (coerce numbers 'vector) #'<)))
    (flet ((part (part) (aref sorted (floor (* part (1- (length sorted)))))))
      (make-extent :lower (part 1/4) :median (part 1/2) :upper (part 3/4) :width (- (part 1) (part 0))))))

(defun middle-width (extent) (- (extent-upper extent) (extent-lower extent)))

(defun far-p (width extent)
  "Whether a range of this WIDTH is out of all proportion to the middle half of the values."
  (< 0 (* 20 (middle-width extent)) width))

(defun scale (extent numbers)
  "One over the width that a curve of these NUMBERS is looked at by."
  (let ((width (- (reduce #'max numbers) (reduce #'min numbers))))
    (when (far-p width extent)
      (setq width (max (* 20 (middle-width extent)) (* 1d-3 (extent-width extent)))))
    (if (plusp width) (/ width) 0d0)))

;;; Where more points are wanted

(defparameter *bend* 1d-3 "So far, in parts of the picture, a curve may be from the line that is drawn for it.")

(defun bent-p (before here after scales)
  "Whether the curve turns so much HERE that its form between the three points is not seen: this is far from the line
between its neighbours, or behind one of them."
  (let ((length 0d0) (along 0d0) (size 0d0))
    (loop for a in before
          for b in here
          for c in after
          for scale in scales
          do (let ((chord (* scale (- c a))) (way (* scale (- b a))))
               (incf length (* chord chord))
               (incf along (* chord way))
               (incf size (* way way))))
    (> (cond ((zerop length) size)
             ((<= 0d0 along length) (- size (/ (* along along) length)))
             (t size))
       (* *bend* *bend*))))

(defun wanted-times (times points scales)
  "Times between TIMES, in their order, where the curve bends or ceases to be real."
  (let ((found '()) (least (* 1d-9 (abs (- (first times) (car (last times)))))))
    (flet ((between (start end)
             (let ((middle (* 0.5d0 (+ start end))))
               (unless (or (eql middle (first found)) (eql middle (second found))) (push middle found)))))
      (loop for (before here after) on points
            for (first middle last) on times
            while middle
            do (cond ((and before here)
                      (when (and after (bent-p before here after scales))
                        (between first middle)
                        (between middle last)))
                     ((and (or before here) (> (abs (- middle first)) least))
                      (between first middle)))))
    (sort (remove-duplicates found) (if (<= (first times) (car (last times))) #'< #'>))))

(defun with-new-points (times points new-times new-points)
  "Both, in the order of time, which may run backwards, as two values."
  (let ((pairs (merge 'list (mapcar #'cons times points) (mapcar #'cons new-times new-points)
                      (if (<= (first times) (car (last times))) #'< #'>) :key #'car)))
    (values (mapcar #'car pairs) (mapcar #'cdr pairs))))

(defun refined-points (motion reader times points extents)
  (loop repeat 16
        while (< (length times) 30000)
        do (let ((wanted (wanted-times times points
                                       (loop for extent in extents
                                             for place from 0
                                             collect (scale extent (values-of points place))))))
             (when (null wanted) (loop-finish))
             (multiple-value-setq (times points)
               (with-new-points times points wanted (points-at motion reader wanted)))))
  points)

;;; What is seen

(defun pole-p (points place extent)
  "Whether the values at PLACE go to infinity: out of all proportion, and the highest one is not yet the top."
  (let ((top nil) (height -1d0))
    (flet ((height (point) (abs (- (nth place point) (extent-median extent)))))
      (loop for (before here after) on (cons nil points)
            for first = t then nil
            do (when (and here (> (height here) height))
                 (setq height (height here)
                       top (list (and (not first) (list before)) here (list after)))))
      (and (far-p height extent)
           (some (lambda (neighbour)
                   (or (null (first neighbour))
                       (> (abs (- (nth place (first neighbour)) (nth place (second top)))) (* 0.3d0 height))))
                 (remove nil (list (first top) (third top))))))))

(defun seen-range (points place extent)
  "(low high) of the values at PLACE; and whether they go on beyond it."
  (let* ((numbers (values-of points place)) (low (reduce #'min numbers)) (high (reduce #'max numbers)))
    (if (pole-p points place extent)
        (let ((margin (* 1.5d0 (middle-width extent))))
          (values (list (max low (- (extent-lower extent) margin)) (min high (+ (extent-upper extent) margin))) t))
        (values (list low high) nil))))

(defun pieces (points seen-p)
  "The parts of POINTS in which all are there and SEEN-P."
  (let ((pieces '()) (piece '()))
    (flet ((finish ()
             (when piece (push (nreverse piece) pieces))
             (setq piece '())))
      (dolist (point points)
        (if (and point (funcall seen-p point)) (push point piece) (finish)))
      (finish))
    (nreverse pieces)))

(maxima::defmfun maxima::$anmech_drawn_curve (record reader)
  "anmech_drawn_curve(record, reader): the curve of what the reader reads, as [[piece, ...], [[low, high], ...]]: each
piece is a list of points, and the ranges are those of what is worth seeing.  [] if the curve is real nowhere."
  (let* ((times (drawing-times record 400 8000)) (points (points-at record reader times))
         (width (length (find-if #'identity points)))
         (extents (loop for place below width collect (extent-of (values-of points place))))
         (points (and extents (refined-points record reader times points extents)))
         (ranges '()) (limits '()))
    (loop for extent in extents
          for place from 0
          do (multiple-value-bind (range beyond) (seen-range points place extent)
               (push range ranges)
               (push (and beyond (let ((width (- (second range) (first range))))
                                   (list (- (first range) width) (+ (second range) width))))
                     limits)))
    (setq limits (nreverse limits))
    (let ((pieces (pieces points (lambda (point)
                                   (every (lambda (number limit)
                                            (or (null limit) (<= (first limit) number (second limit))))
                                          point limits)))))
      (if (null pieces)
          (maxima-list '())
          (maxima-list (list (maxima-list (mapcar (lambda (piece) (maxima-list (mapcar #'numbers-list piece))) pieces))
                             (maxima-list (mapcar #'numbers-list (nreverse ranges)))))))))
